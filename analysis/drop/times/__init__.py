"""From a sound or a list of events to impact times and the fit of the bounce laws."""
