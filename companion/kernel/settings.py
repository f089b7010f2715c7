"""Settings are frozen values read from TOML; every key is checked, and errors name it."""

import difflib
import tomllib
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from companion.kernel.errors import PlanError

T = TypeVar("T")


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all settings sections."""


def read_toml(path: Path) -> dict[str, Any]:
    """The table in a TOML file. Raises PlanError naming the file and the line."""
    try:
        with path.open("rb") as file:
            return tomllib.load(file)
    except FileNotFoundError:
        raise PlanError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise PlanError(f"{path}: cannot be read: {error}") from error
    except tomllib.TOMLDecodeError as error:
        raise PlanError(f"{path}: not valid TOML: {error}") from error


def convert_settings(table: dict[str, Any], kind: type[T], source: str) -> T:
    """``table`` as a value of ``kind``. Raises PlanError: source, key path, what is allowed."""
    _refuse_unknown(table, kind, source, ())
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        text, _, where = str(error).partition(" - at `$")
        key = where.rstrip("`").lstrip(".")
        raise PlanError(f"{source}: {key or 'top level'}: {text}") from error


def _refuse_unknown(
    table: dict[str, Any], kind: object, source: str, prefix: tuple[str, ...]
) -> None:
    """msgspec names the first unknown key but not the allowed ones; a user needs both."""
    if not (isinstance(kind, type) and issubclass(kind, msgspec.Struct)):
        return
    fields = {field.encode_name: field.type for field in msgspec.structs.fields(kind)}
    for key, value in table.items():
        path = ".".join((*prefix, key))
        if key not in fields:
            near = difflib.get_close_matches(key, fields, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise PlanError(
                f"{source}: {path}: unknown key; {hint}allowed here: {', '.join(sorted(fields))}"
            )
        if isinstance(value, dict):
            _refuse_unknown(value, fields[key], source, (*prefix, key))
