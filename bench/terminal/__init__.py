"""TODO what terminal is for."""
