"""TODO what loop is for."""
