"""TODO what signals is for."""
