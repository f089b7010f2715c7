"""The flight log: one record and one stereo pair, beside the plainest way to keep them."""

import json
import tempfile
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import msgspec
import numpy as np

from companion.flightlog import FlightLogWriter, FlightMetadata, Topic
from companion.kernel.messages import StereoFrame, Telemetry
from tools.bench.harness import Row, race_row
from tools.bench.perception import SEED, stereo_pair

FRAME_NS = 100_000_000
RECORDS = 50


def rows() -> Iterator[Row]:
    metadata = FlightMetadata(plan={}, seed=SEED, version="bench")
    left, right = stereo_pair(np.random.default_rng(SEED))
    stamps_ns = count(step=FRAME_NS)
    telemetry = Telemetry(position_ned_m=(1.0 / 3.0, 2.0 / 3.0, -1.0), yaw_rad=0.1)
    with (
        tempfile.TemporaryDirectory() as folder,
        (Path(folder) / "plain.jsonl").open("w") as plain,
        FlightLogWriter(Path(folder) / "flight.mcap", metadata, images="stereo") as log,
    ):

        def log_records() -> None:
            for _ in range(RECORDS):
                log.write(
                    Topic.TELEMETRY, msgspec.structs.replace(telemetry, stamp_ns=next(stamps_ns))
                )

        def dump_records() -> None:
            for _ in range(RECORDS):
                record = msgspec.structs.replace(telemetry, stamp_ns=next(stamps_ns))
                plain.write(json.dumps(msgspec.structs.asdict(record)) + "\n")
                plain.flush()

        def log_frame() -> None:
            log.write_frame(StereoFrame(next(stamps_ns), left, right))

        def save_frame() -> None:
            np.savez_compressed(Path(folder) / "pair.npz", left=left, right=right)

        yield race_row(
            f"log {RECORDS} records, 10 per second of flight",
            log_records,
            ("json.dumps, a line each", dump_records),
            goal=RECORDS * 0.02,
            rounds=100,
        )
        yield race_row("log a stereo pair", log_frame, ("numpy savez_compressed", save_frame))
