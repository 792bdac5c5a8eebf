"""Robots: URDF files and their reader, which returns a frozen `Robot`."""
