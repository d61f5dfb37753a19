"""TODO what importers is for."""
