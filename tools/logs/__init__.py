"""Reads logs of any flight: ours (MCAP), ground stations' (.tlog), PX4's (.ulg).

Every log is a set of named series on the time base of its own clock; ``align`` finds how far two
clocks are apart.
"""

from tools.logs.opening import find_log, open_log
from tools.logs.series import Health, LogReader, Table

__all__ = ["Health", "LogReader", "Table", "find_log", "open_log"]
