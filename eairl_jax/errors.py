"""The exceptions that a user of the library has to handle."""


class InputError(ValueError):
    """Bad input, raised before anything is compiled.

    The message says what was wrong, what was expected, and how to fix it.
    """


class Diverged(RuntimeError):
    """A metric of a training became NaN or infinite.

    Attributes:
      metric, value: its name, and its value.
      lane: the lane in which it happened, from 0.
      iteration: the iteration of the call, from 1.
    """

    def __init__(self, message: str, metric: str, lane: int, iteration: int, value: float):
        super().__init__(message)
        self.metric, self.lane, self.iteration, self.value = metric, lane, iteration, value


class ProcessLost(RuntimeError):
    """One of several processes that train together is gone, was never there, or has failed."""
