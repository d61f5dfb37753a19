"""Laws of one flight and of one bounce, in closed form."""
