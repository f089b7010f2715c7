"""Words of the command line that need more than a type: settings, places, lists of links."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from companion.kernel.errors import PlanError
from companion.kernel.settings import read_toml

HOME_KEYS = ("latitude_deg", "longitude_deg", "amsl_m")


def read_settings(
    path: Path | None,
    home: str | None = None,
    parameters: Sequence[str] = (),
    faults: Sequence[str] = (),
) -> dict[str, Any]:
    """The plan's [sitl] table from a TOML or JSON file; ``home`` replaces the table's.

    ``parameters`` (NAME=VALUE) are set after the table's, ``faults`` (JSON) come beside the
    table's events. Raises PlanError.
    """
    table = {} if path is None else _read_table(path)
    if home is not None:
        table["home"] = home_table(home)
    if parameters:
        table["parameters"] = table.get("parameters", {}) | dict(map(parameter, parameters))
    if faults:
        table["events"] = [*table.get("events", ()), *map(event, faults)]
    return table


def event(text: str) -> dict[str, Any]:
    """A fault as JSON; what acts from the start needs no time. Raises PlanError."""
    try:
        return {"at_s": 0.0, **msgspec.json.decode(text, type=dict[str, Any])}
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise PlanError(f"--fault {text}: {error}") from error


def home_table(text: str) -> dict[str, float]:
    """LAT,LON or LAT,LON,ALT as the plan's sitl.home. Raises PlanError."""
    words = text.split(",")
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    if len(numbers) not in {2, 3}:
        raise PlanError(f"--home {text}: not LAT,LON or LAT,LON,ALT in degrees and metres")
    return dict(zip(HOME_KEYS, numbers, strict=False))


def parameter(text: str) -> tuple[str, float]:
    """NAME=VALUE. Raises PlanError."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise PlanError(f"--param {text}: not NAME=VALUE with a number") from None


def spread_links(words: Sequence[str]) -> list[str]:
    """``--mavlink A B`` as ``--mavlink A --mavlink B``; a link is a word with :// in it."""
    spread: list[str] = []
    for word in words:
        if "://" in word and len(spread) > 1 and "://" in spread[-1] and spread[-2] == "--mavlink":
            spread.append("--mavlink")
        spread.append(word)
    return spread


def _read_table(path: Path) -> dict[str, Any]:
    if path.suffix != ".json":
        return read_toml(path)
    try:
        table = json.loads(path.read_bytes())
    except OSError as error:
        raise PlanError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise PlanError(f"{path}: not valid JSON: {error}") from error
    if not isinstance(table, dict):
        raise PlanError(f"{path}: must hold a table, not {type(table).__name__}")
    return table
