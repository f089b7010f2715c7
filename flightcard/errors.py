"""What a flight card raises when the flight is not what was expected."""


class NotMetError(AssertionError):
    """An expectation was not met; the text says what was expected and what was seen, and when."""
