"""Robots: URDF files and the reader that turns one into a frozen `Robot`."""
