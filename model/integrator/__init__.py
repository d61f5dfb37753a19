"""TODO what integrator is for."""
