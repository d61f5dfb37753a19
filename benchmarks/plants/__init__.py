"""TODO what plants is for."""
