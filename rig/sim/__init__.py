"""The simulated rig: its own physics, which sees drive samples only."""
