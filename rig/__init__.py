"""Everything that moves the plate; never imports `model` or `analysis`."""
