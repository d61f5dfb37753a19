"""TODO what predict is for."""
