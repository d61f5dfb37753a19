"""TODO what attribution is for."""
