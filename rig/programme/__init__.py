"""TODO what programme is for."""
