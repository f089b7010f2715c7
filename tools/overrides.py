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
    return f"{key}={_toml(value)}"


def label_of(key: str, value: object) -> str:
    """A short name for one choice."""
    if isinstance(value, str):
        return value
    return f"{key.rpartition('.')[2]}={msgspec.json.encode(value).decode()}"


def _toml(value: object) -> str:
    """On one line; TOML's simple values are written as JSON's."""
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_toml(key)} = {_toml(held)}' for key, held in value.items())}}}"
    return msgspec.json.encode(value).decode()
