"""Figures, sentences and the page that show a result; nothing is computed here that the result does not hold.

Other rooms take `page`, `figures_flights`, `figures_plate`, `style`, `gamma`, `narrative` and `wording`.
"""
