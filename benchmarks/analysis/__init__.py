"""TODO what analysis is for."""
