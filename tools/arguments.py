"""Kinds of command-line arguments that the tools share."""


def count(text: str) -> int:
    """A whole number of at least 1; argparse says "invalid count value" of others."""
    number = int(text)
    if number < 1:
        raise ValueError(text)
    return number
