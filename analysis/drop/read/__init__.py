"""Tables of any layout: impact times, or positions."""
