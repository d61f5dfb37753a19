"""TODO what flights is for."""
