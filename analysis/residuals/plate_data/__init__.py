"""Numbers of each step that compare the plate with its drive, and what modulation and a ringing mode add to them.

Other rooms take `plate_observables` and `modulation`; the forward model and the observations take the rest.
"""
