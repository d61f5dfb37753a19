"""TODO what fakes is for."""
