"""Tables of a TOML file that change a plan, as the ``KEY=VALUE`` words it is loaded with."""

from collections.abc import Iterator, Mapping
from typing import Any

import msgspec


def leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Values by dotted key; ``a.b = 1``, ``a = { b = 1 }`` and ``"a.b" = 1`` are the same."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def as_word(key: str, value: object) -> str:
    """What ``--set`` would be told."""
    return f"{key}={msgspec.json.encode(value).decode()}"


def label_of(key: str, value: object) -> str:
    """A short name for one choice."""
    if isinstance(value, str):
        return value
    return f"{key.rpartition('.')[2]}={msgspec.json.encode(value).decode()}"
