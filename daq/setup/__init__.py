"""TODO what setup is for."""
