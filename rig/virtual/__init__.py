"""The simulated plant as a process of its own, behind a real driver."""
