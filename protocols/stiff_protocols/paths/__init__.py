"""Tool paths, joint positions along them, and commands that correct for deflection."""
