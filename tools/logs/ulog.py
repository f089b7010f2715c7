"""PX4's own log."""

import sys
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import pyulog

from companion.kernel.errors import RecordingError
from tools.logs.series import Health, Table, backward_steps, problem, remark

ULOG_MAGIC = b"ULog\x01\x12\x35"
_DAMAGE = (pyulog.core.ULogException, ValueError, IndexError, KeyError, TypeError)
"""What pyulog raises where bytes make no sense."""


class ULogReader:
    """Series are message names, ``name[1]`` for a second instance; time is since boot."""

    kind = "PX4 log (ULog)"

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with path.open("rb") as file, redirect_stdout(sys.stderr):  # it prints its warnings
                self._ulog = pyulog.ULog(file)
        except OSError as error:
            raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
        except _DAMAGE as error:
            raise RecordingError(f"{path}: not a PX4 log: {error}") from error
        self._series = {
            data.name + (f"[{data.multi_id}]" if data.multi_id else ""): data.data
            for data in self._ulog.data_list
            if "timestamp" in data.data  # without one it is no series, and the file is damaged
        }
        if not self._series:
            raise RecordingError(f"{path}: holds no data")

    def facts(self) -> dict[str, str]:
        info = self._ulog.msg_info_dict
        named = {"sys_name": "system", "ver_hw": "hardware", "ver_sw": "software"}
        facts = {label: str(info[key]) for key, label in named.items() if key in info}
        release = self._ulog.get_version_info_str()
        return facts | ({"release": release} if release else {})

    def records(self) -> dict[str, int]:
        return {name: len(data["timestamp"]) for name, data in sorted(self._series.items())}

    def table(self, series: str) -> Table:
        if series not in self._series:
            raise RecordingError(f"{self.path}: no message {series}")
        columns = dict(self._series[series])
        return Table(columns.pop("timestamp").astype(np.float64) * 1e-6, columns)

    def examine(self) -> Health:
        findings = []
        if self._ulog.file_corruption:
            findings.append(problem("damaged: some of its bytes make no sense"))
        dropouts_s = [dropout.duration * 1e-3 for dropout in self._ulog.dropouts]
        if dropouts_s:
            findings.append(
                remark(
                    f"{len(dropouts_s)} dropouts while logging, {sum(dropouts_s):.2f} s in all, "
                    f"the longest {max(dropouts_s):.2f} s"
                )
            )
        for name in sorted(self._series):
            findings += backward_steps(name, self.table(name).time_s)
        return Health(self.records(), findings)
