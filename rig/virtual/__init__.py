"""The simulated plant behind real drivers, in a process of its own.

Other rooms take `jack`, `serial`.
"""
