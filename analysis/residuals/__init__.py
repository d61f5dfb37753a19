"""TODO what residuals is for."""
