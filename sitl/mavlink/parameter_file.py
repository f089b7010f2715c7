"""Saved parameters as the ground stations write them: system, component, name, value, type."""

import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from companion.kernel.errors import PlanError
from sitl.autopilot.parameters import (
    PARAMETERS,
    Number,
    default_parameters,
    parameter_problem,
)

logger = logging.getLogger(__name__)

_HEADER: Final = "# Vehicle-Id Component-Id Name Value Type\n"
_INT32, _REAL32 = 6, 9  # MAV_PARAM_TYPE


class ParameterFile:
    """``last`` is what was read or saved last: all parameters, defaults where the file is silent.

    A file that is not there yet is made by ``save``.
    """

    def __init__(self, path: Path) -> None:
        """Raises PlanError for a line that is not a parameter of this vehicle in its range."""
        self._path = path
        self.last: dict[str, Number] = default_parameters() | self._read()

    def save(self, values: Mapping[str, Number]) -> bool:
        """Whether it worked; a reader never sees half a file."""
        kept = dict(values)
        system_id, component_id = kept["MAV_SYS_ID"], kept["MAV_COMP_ID"]
        lines = [
            f"{system_id}\t{component_id}\t{name}\t{value!r}\t"
            f"{_INT32 if isinstance(value, int) else _REAL32}\n"
            for name, value in sorted(kept.items())
        ]
        unfinished = self._path.with_name(self._path.name + ".new")
        try:
            unfinished.write_text(_HEADER + "".join(lines), encoding="ascii")
            os.replace(unfinished, self._path)
        except OSError as error:
            logger.error("%s: parameters cannot be saved: %s", self._path, error.strerror)
            return False
        self.last = kept
        return True

    def _read(self) -> dict[str, Number]:
        try:
            lines = self._path.read_text(encoding="ascii").splitlines()
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise PlanError(f"{self._path}: cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise PlanError(f"{self._path}: not a parameter file ({error.reason})") from error
        found = {}
        for number, line in enumerate(lines, start=1):
            if line.strip() and not line.startswith("#"):
                name, value = _parsed(line, f"{self._path}:{number}")
                found[name] = value
        return found


def _parsed(line: str, place: str) -> tuple[str, Number]:
    fields = line.split()
    try:
        name, value = fields[2], float(fields[3])
    except (IndexError, ValueError):
        raise PlanError(f"{place}: not 'system component name value type'") from None
    limits = PARAMETERS.get(name)
    if limits is None or not limits.lowest <= value <= limits.highest:  # NaN is in no range
        raise PlanError(f"{place}: {name}: {value:g}: {parameter_problem(name)}")
    return name, round(value) if isinstance(limits.default, int) else value
