"""Long-run motion at one gamma, and what a contact circuit shows of it.

Other rooms take `attractor`, `make_ball`, `exact_ball`, `landing_map`.
"""
