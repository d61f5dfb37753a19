"""The programme of a run: steps, forcing, and the sequencer that turns them into drive samples.

Other rooms take `ramp`, `sequencer`.
"""
