"""The parts of `bench predict`: one orbit, bifurcations, diagrams, a profile's ramp, and their figures.

Other packages take `request`, `answer`, `profile_ramp` and `figures`.
"""
