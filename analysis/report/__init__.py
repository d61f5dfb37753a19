"""Figures, sentences and the page that show a result; nothing is computed here that the result does not hold.

Other rooms take `page`, `run_page`, `figures`, `narrative` and `wording`.
"""
