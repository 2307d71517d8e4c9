"""The exception that a user of the library has to handle."""


class InputError(ValueError):
    """Bad input, raised before anything is compiled.

    The message says what was wrong, what was expected, and how to fix it.
    """
