"""TODO what events is for."""
