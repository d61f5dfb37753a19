"""TODO what formats is for."""
