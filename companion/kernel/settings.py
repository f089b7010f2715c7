"""Settings are frozen values read from TOML; every key is checked, and errors name it."""

import difflib
import math
import re
import tomllib
from pathlib import Path
from typing import Any, Literal, TypeGuard, TypeVar, get_args, get_origin

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
    except RecursionError:
        raise PlanError(f"{path}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # a path that no system takes
        raise PlanError(f"{path}: cannot be read: {error}") from error


def convert_settings(table: dict[str, Any], kind: type[T], source: str) -> T:
    """``table`` as a value of ``kind``. Raises PlanError: source, key path, what is allowed."""
    _refuse_unknown(table, kind, source, ())
    _refuse_not_finite(table, source, "")
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as error:
        text, _, where = str(error).partition(" - at `$")
        key = where.rstrip("`").lstrip(".")
        choices = _choices_at(kind, key)
        if choices:
            text = f"{text}; allowed: {', '.join(map(str, choices))}"
        raise PlanError(f"{source}: {key or 'top level'}: {text}") from error


def _choices_at(kind: object, key: str) -> tuple[object, ...]:
    """The words that may stand at this key; none where it holds something else."""
    for part in re.findall(r"[^.\[\]]+", key):
        if _is_struct(kind):
            kind = _field_types(kind).get(part)
        else:
            kind = next(iter(get_args(kind)), None)
    return get_args(kind) if get_origin(kind) is Literal else ()


def _is_struct(kind: object) -> TypeGuard[type[msgspec.Struct]]:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _field_types(kind: type[msgspec.Struct]) -> dict[str, Any]:
    return {field.encode_name: field.type for field in msgspec.structs.fields(kind)}


def _refuse_unknown(
    table: dict[str, Any], kind: object, source: str, prefix: tuple[str, ...]
) -> None:
    """msgspec names the first unknown key but not the allowed ones; a user needs both."""
    if not _is_struct(kind):
        return
    fields = _field_types(kind)
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
        elif isinstance(value, list):
            item_kind = next(iter(get_args(fields[key])), None)
            for place, item in enumerate(value):
                if isinstance(item, dict):
                    _refuse_unknown(item, item_kind, source, (*prefix, f"{key}[{place}]"))


def _refuse_not_finite(value: object, source: str, path: str) -> None:
    """TOML knows nan and inf; no setting does, and limits would let a NaN pass."""
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_not_finite(item, source, f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for place, item in enumerate(value):
            _refuse_not_finite(item, source, f"{path}[{place}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise PlanError(f"{source}: {path}: {value}; must be a finite number")
