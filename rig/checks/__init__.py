"""TODO what checks is for."""
