"""TODO what report is for."""
