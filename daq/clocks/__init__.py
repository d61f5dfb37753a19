"""TODO what clocks is for."""
