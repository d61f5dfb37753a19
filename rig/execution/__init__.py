"""TODO what execution is for."""
