"""The folder that a flight leaves: its name, its files, and what they say of how it ended."""

import logging
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from companion.kernel.errors import CompanionError
from companion.plan import Plan
from companion.summary import Summary

LOG_NAME = "flight.mcap"
SUMMARY_NAME = "summary.json"
SUMMARY_BYTES = 4096
"""Taken on the disk before take-off, so that a disk that fills up in flight still gets the summary;
a companion that is killed leaves the one written then.
"""
KILLED = "the companion was killed in flight"
LANDED_ALONE = "the companion was killed in flight; the vehicle landed without it"

logger = logging.getLogger(__name__)


class _Ending(msgspec.Struct):
    """What is read of a summary, whichever version wrote it."""

    reason: str = ""


def new_log_dir(parent: Path, plan: Plan, plan_path: Path) -> Path:
    """``parent/<stamp>-<plan>-<seed>``, made here. Raises CompanionError."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    stem = f"{stamp}-{plan_path.stem}-{plan.seed}"
    for suffix in ("", *(f"-{count}" for count in range(2, 100))):
        path = parent / (stem + suffix)
        try:
            path.mkdir(parents=True)
        except FileExistsError:
            continue
        except OSError as error:
            raise CompanionError(f"{path}: cannot be made: {error.strerror}") from error
        return path
    raise CompanionError(f"{parent / stem}: too many flights within one second")


def reserve_summary(folder: Path, summary: Summary) -> None:
    """What stands in the folder until the flight is over. Raises CompanionError."""
    path = folder / SUMMARY_NAME
    try:
        path.write_bytes(_json(summary).ljust(SUMMARY_BYTES))
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from error


def write_summary(folder: Path, summary: Summary) -> None:
    """In the place that was reserved. Raises CompanionError."""
    path = folder / SUMMARY_NAME
    try:
        with path.open("r+b") as file:
            file.write(_json(summary))
            file.truncate()
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from error


def interrupted_flight(parent: Path, but: Path) -> Path | None:
    """The newest flight's folder other than ``but``, if that flight never came to its end."""
    flights = [path for path in parent.iterdir() if (path / SUMMARY_NAME).is_file()]
    newest = max((path for path in flights if path != but), key=lambda p: p.name, default=None)
    return newest if newest is not None and _reason(newest) == KILLED else None


def close_interrupted(folder: Path) -> None:
    """Notes that the interrupted flight is over: the vehicle was found on the ground."""
    path = folder / SUMMARY_NAME
    try:
        summary = msgspec.json.decode(path.read_bytes()) | {"reason": LANDED_ALONE}
        path.write_bytes(msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n")
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from error


def _reason(folder: Path) -> str:
    """Empty where it cannot be told."""
    try:
        return msgspec.json.decode((folder / SUMMARY_NAME).read_bytes(), type=_Ending).reason
    except (OSError, msgspec.MsgspecError) as error:
        logger.warning("%s: %s", folder / SUMMARY_NAME, error)
        return ""


def _json(summary: Summary) -> bytes:
    return msgspec.json.format(msgspec.json.encode(summary), indent=2) + b"\n"
