"""TODO what model is for."""
