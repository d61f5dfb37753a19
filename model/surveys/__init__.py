"""Many parameter points: diagrams and ensembles.

Other rooms take `diagram`, `ensemble`.
"""
