"""TODO what surveys is for."""
