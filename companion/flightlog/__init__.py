"""The flight log: an MCAP file whose topics are record types and whose fields are columns.

Messages are JSON with a JSON schema each, as viewers such as Foxglove want them. NaN is
``null`` in the file and NaN again when read; infinity has no place in JSON and becomes NaN too.
"""

from companion.flightlog.reader import FlightLog
from companion.flightlog.records import FlightMetadata, Topic
from companion.flightlog.schema import Columns
from companion.flightlog.writer import FlightLogWriter

__all__ = ["Columns", "FlightLog", "FlightLogWriter", "FlightMetadata", "Topic"]
