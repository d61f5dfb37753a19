"""Types of the drop test's arrays."""
