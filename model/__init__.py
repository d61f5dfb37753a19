"""Models of the ball on the vibrating plate, from the exact ideal flight to any set of effects.

Other rooms take `tones`, `effects`, and the rooms below: flight < integrator < orbits < bifurcations < surveys.
"""
