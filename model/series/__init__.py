"""TODO what series is for."""
