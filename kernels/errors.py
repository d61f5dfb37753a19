"""What a person handed in cannot be used: the one error that a command takes for the caller's fault."""


class InputError(ValueError):
    """Bad input: the message names the file, the place, what was wanted, what came and what to do."""
