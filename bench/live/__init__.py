"""The live page: a running ramp watched and stopped from a browser."""
