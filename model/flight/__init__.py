"""TODO what flight is for."""
