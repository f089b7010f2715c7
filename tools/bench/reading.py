"""Reading a flight log as the analysis tools do, beside the plainest way to."""

import json
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader

from companion.flightlog import Columns, FlightLog, FlightLogWriter, FlightMetadata, Topic
from companion.kernel.messages import (
    BehaviourState,
    Cue,
    Decision,
    MocapPose,
    Percept,
    Phase,
    Setpoint,
    Telemetry,
)
from tools.bench.harness import Row, race_row
from tools.bench.perception import SEED

TOPICS = (Topic.PERCEPT, Topic.DECISION, Topic.MOCAP)
FLIGHT_S = 600.0
FRAME_NS = 100_000_000
POSE_NS = 10_000_000
ROUNDS = 5


def rows(flight_s: float = FLIGHT_S) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        write_flight(path, round(flight_s * 1e9))
        yield race_row(
            f"read a log of {flight_s:g} s: λ, decisions, poses of the frames",
            lambda: read(path),
            ("mcap's reader, json.loads", lambda: read_plainly(path)),
            rounds=ROUNDS,
            warm_up=1,
        )


def read(path: Path) -> list[Columns]:
    """Percepts, decisions, and the pose nearest to each of them."""
    log = FlightLog(path)
    percept, decision = log.tables(Topic.PERCEPT, Topic.DECISION)
    return [percept, decision, log.nearest(Topic.MOCAP, decision["stamp_ns"])]


def read_plainly(path: Path) -> list[Columns]:
    """The same, of records whose fields are all there."""
    records: dict[str, list[dict[str, Any]]] = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(TOPICS, log_time_order=False):
            records[channel.topic].append(json.loads(message.data))
    percept, decision, poses = (
        {name: np.array([record[name] for record in records[topic]]) for name in records[topic][0]}
        for topic in TOPICS
    )
    between_ns = (poses["stamp_ns"][1:] + poses["stamp_ns"][:-1]) // 2
    nearest = np.searchsorted(between_ns, decision["stamp_ns"])
    return [percept, decision, {name: column[nearest] for name, column in poses.items()}]


def write_flight(path: Path, flight_ns: int) -> None:
    """What a flight of this length logs, as many records and as many digits."""
    rng = np.random.default_rng(SEED)
    with FlightLogWriter(path, FlightMetadata(plan={}, seed=SEED, version="bench")) as log:
        for stamp_ns in range(0, flight_ns, POSE_NS):
            place_m, clearance_m = tuple(rng.uniform(-3.0, 3.0, 3).tolist()), float(rng.random())
            log.write(Topic.MOCAP, _pose(stamp_ns, place_m, clearance_m))
            if stamp_ns % FRAME_NS == 0:
                log.write(Topic.TELEMETRY, Telemetry(stamp_ns=stamp_ns, position_ned_m=place_m))
                log.write(Topic.PERCEPT, _percept(stamp_ns, rng))
                log.write(Topic.DECISION, _decision(stamp_ns, clearance_m))
                log.write(Topic.SETPOINT, Setpoint(stamp_ns=stamp_ns))


def _pose(stamp_ns: int, place_m: tuple[float, float, float], clearance_m: float) -> MocapPose:
    return MocapPose(
        stamp_ns=stamp_ns,
        truth_position_ned_m=place_m,
        truth_ned_from_frd=(1.0, *place_m),
        truth_clearance_m=clearance_m,
        truth_collisions=0,
    )


def _percept(stamp_ns: int, rng: np.random.Generator) -> Percept:
    stereo_px, mono_px, std_px, novelty, motion_px, fused_px = rng.uniform(0.0, 8.0, 6).tolist()
    return Percept(
        stamp_ns=stamp_ns,
        stereo_px=stereo_px,
        stereo_valid_norm=0.5,
        mono_px=mono_px,
        mono_std_px=std_px,
        mono_novelty=novelty,
        motion_px=motion_px,
        fused_px=fused_px,
        fused_std_px=std_px,
    )


def _decision(stamp_ns: int, disparity_px: float) -> Decision:
    return Decision(
        stamp_ns=stamp_ns,
        phase=Phase.TEST,
        cue=Cue.MONO,
        override=False,
        disparity_px=disparity_px,
        threshold_px=3.5,
        state=BehaviourState.STRAIGHT,
        overrides=0,
        turns=0,
        approaches=0,
    )
