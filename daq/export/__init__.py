"""TODO what export is for."""
