"""TODO what bifurcations is for."""
