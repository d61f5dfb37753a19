"""TODO what orbits is for."""
