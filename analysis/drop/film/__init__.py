"""From a film or tracked positions to flights, impacts and the fit of their shapes."""
