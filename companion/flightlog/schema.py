"""Between record types and JSON: schemas for viewers, NaN through null, tables of columns."""

from collections.abc import Callable, Sequence
from types import NoneType
from typing import Any

import numpy as np
from msgspec import inspect
from numpy.typing import NDArray

from companion.kernel.messages import NAN

Restorer = Callable[[Any], Any]
Columns = dict[str, NDArray[Any]]


def json_schema(kind: type) -> dict[str, Any]:
    """The JSON schema of a Struct, without references or nested arrays: viewers know neither."""
    info = inspect.type_info(kind)
    if not isinstance(info, inspect.StructType):
        raise TypeError(f"{kind.__name__}: a log record must be a msgspec Struct")
    return {"title": kind.__name__, **_describe(info)}


def encodable(value: object) -> object:
    """msgspec's ``enc_hook``: numpy scalars and arrays as plain numbers and lists."""
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise NotImplementedError(f"{type(value).__name__} has no place in a log")


def nan_restorer(kind: type) -> Restorer:
    """Of decoded JSON of this kind: null becomes NaN where the type says number."""
    return _restorer(inspect.type_info(kind)) or (lambda value: value)


def table(rows: Sequence[dict[str, Any]]) -> Columns:
    """Decoded records as columns of shape (n_rows,) or (n_rows, n) for vectors.

    Fields of nested records get dotted names; null becomes NaN.
    """
    if not rows:
        return {}
    fields = {name: [row.get(name) for row in rows] for name in rows[0]}
    if any(dict in map(type, values) for values in fields.values()):
        return table([_flatten(row) for row in rows])
    return {name: _column(values) for name, values in fields.items()}


def _describe(info: inspect.Type) -> dict[str, Any]:
    match info:
        case inspect.BoolType():
            return {"type": "boolean"}
        case inspect.IntType():
            return {"type": "integer"}
        case inspect.FloatType():
            return {"type": "number"}
        case inspect.BytesType():
            return {"type": "string", "contentEncoding": "base64"}
        case inspect.StructType(fields=fields):
            return {
                "type": "object",
                "properties": {field.encode_name: _describe(field.type) for field in fields},
            }
        case inspect.TupleType(item_types=items):
            count = len(items)
            return {
                "type": "array", "items": _describe(items[0]), "minItems": count, "maxItems": count,
            }  # fmt: skip
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            return {"type": "array", "items": _describe(item)}
        case inspect.CustomType(cls=cls) if cls is np.ndarray:
            return {"type": "array", "items": {"type": "number"}}
        case inspect.UnionType(types=types):
            return _describe(next(t for t in types if not isinstance(t, inspect.NoneType)))
        case inspect.DictType():
            return {"type": "object", "properties": {}}
        case _:
            return {"type": "string"}


def _restorer(info: inspect.Type) -> Restorer | None:
    """None where no number can be below ``info``."""
    match info:
        case inspect.FloatType():
            return lambda value: NAN if value is None else value
        case inspect.StructType(fields=fields):
            return _struct_restorer({f.encode_name: _restorer(f.type) for f in fields})
        case inspect.TupleType(item_types=(item, *_)):
            return _sequence_restorer(_restorer(item))
        case inspect.VarTupleType(item_type=item) | inspect.ListType(item_type=item):
            return _sequence_restorer(_restorer(item))
        case _:
            return None


def _struct_restorer(fields: dict[str, Restorer | None]) -> Restorer | None:
    deep = [(name, restore) for name, restore in fields.items() if restore]

    def restore_fields(record: dict[str, Any]) -> dict[str, Any]:
        for name, restore in deep:
            if name in record:
                record[name] = restore(record[name])
        return record

    return restore_fields if deep else None


def _sequence_restorer(item: Restorer | None) -> Restorer | None:
    return None if item is None else lambda values: [item(value) for value in values]


def _flatten(row: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            flat.update(_flatten(value, f"{prefix}{name}."))
        else:
            flat[prefix + name] = value
    return flat


def _column(values: list[Any]) -> NDArray[Any]:
    kinds = set(map(type, values))
    if str in kinds:
        return np.array(["" if value is None else value for value in values])
    if kinds.isdisjoint((NoneType, list)):
        return np.array(values)
    return np.array(values, dtype=np.float64)
