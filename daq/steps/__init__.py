"""TODO what steps is for."""
