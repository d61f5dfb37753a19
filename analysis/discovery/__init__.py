"""TODO what discovery is for."""
