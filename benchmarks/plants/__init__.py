"""A second simulated rig by other means, for blind tests."""
