"""TODO what profiles is for."""
