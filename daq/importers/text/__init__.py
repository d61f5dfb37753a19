"""Text files as tables of numbers."""
