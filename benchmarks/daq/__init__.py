"""TODO what daq is for."""
