"""The one exception a user of the library has to know."""


class InputError(ValueError):
    """Bad input, found before any compute is spent: says what was wrong, what was expected, how to fix it."""
