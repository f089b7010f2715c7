"""A flight in lockstep, in a process of its own that can be killed at any moment."""

import asyncio
import mmap
import multiprocessing
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from companion.flight import FlightOrder, fly_plan
from companion.kernel.errors import CompanionError
from companion.pipeline import Pipeline, Step

PROGRESS_NAME = "progress"
"""Beside the log, and no part of a flight: the stamp of the newest frame that was flown."""
LOOK_PERIOD_S = 0.002
END_LIMIT_S = 120.0
LONGEST_PAUSE_S = 0.02
"""Wall time: about a frame, so that the kill comes anywhere in its work."""

_STAMP_NS = struct.Struct("<q")


def fly(order: FlightOrder) -> None:
    """The process's work."""
    cv2.setNumThreads(1)  # as the app does
    with _open_progress(order.log_dir, writable=True) as progress:

        def note(step: Step, pipeline: Pipeline) -> None:
            _STAMP_NS.pack_into(progress, 0, step.percept.stamp_ns)

        asyncio.run(fly_plan(order, note, stop_signals=()))


def kill_in_flight(order: FlightOrder, after_s: float, rng: np.random.Generator) -> int:
    """Flies and kills it this long after its first frame; the stamp of the last one flown.

    Raises CompanionError when it ends by itself before.
    """
    (order.log_dir / PROGRESS_NAME).write_bytes(_STAMP_NS.pack(0))
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload([__name__])  # importing takes longer than flying
    process = server.Process(target=fly, args=(order,))
    with _open_progress(order.log_dir, writable=False) as progress:
        process.start()
        first_ns = 0
        try:
            while (stamp_ns := _STAMP_NS.unpack_from(progress)[0]) < first_ns + after_s * 1e9:
                first_ns = first_ns or stamp_ns
                process.join(LOOK_PERIOD_S)
                if process.exitcode is not None:
                    raise CompanionError(f"{order.log_dir}: ended before it could be killed")
            process.join(rng.uniform(0.0, LONGEST_PAUSE_S))
        finally:
            process.kill()
            process.join(END_LIMIT_S)
        return int(_STAMP_NS.unpack_from(progress)[0])


@contextmanager
def _open_progress(folder: Path, writable: bool) -> Iterator[mmap.mmap]:
    """Shared memory that outlives the process."""
    access = mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ
    with (
        (folder / PROGRESS_NAME).open("r+b") as file,
        mmap.mmap(file.fileno(), _STAMP_NS.size, access=access) as shared,
    ):
        yield shared
