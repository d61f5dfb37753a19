"""The desk's page of drop tests: impacts marked in a sound, a film's track or a table, and corrected by hand."""
