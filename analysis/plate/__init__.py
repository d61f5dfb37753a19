"""TODO what plate is for."""
