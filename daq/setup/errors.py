"""Errors at the edges: what a person handed in cannot be used."""


class InputError(ValueError):
    """Bad input: the message names the file, the place, what was wanted, what came and what to do."""
