"""What the ideal ball would do, and each effect that may be added to it."""
