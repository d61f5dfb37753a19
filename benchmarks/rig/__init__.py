"""TODO what rig is for."""
