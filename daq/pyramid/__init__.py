"""Minima and maxima of a recording over ever longer stretches, so that an hour is drawn as fast as a second."""
