"""Whole flights on simulated time: how many times faster than real time."""

import asyncio
import tempfile
from collections.abc import Iterator
from pathlib import Path

from companion.flight import FlightOrder, fly_plan
from companion.kernel.clock import wall_s
from companion.kernel.errors import CompanionError
from companion.plan import Plan, load_plan, room_path
from companion.summary import Summary
from sitl.build import build
from tools.bench.harness import PLAN, Row

GOALS = {10.0: 40.0, 30.0: 15.0}
"""Least times real time, by camera rate."""
SHORT = ("experiment.initial_s=10", "experiment.learning_s=40", "experiment.test_s=40")
ALONE_S = 30.0
ROUNDS = 3


def rows() -> Iterator[Row]:
    for rate_hz, goal in GOALS.items():
        plan = load_plan(PLAN, (*SHORT, f"camera.rate_hz={rate_hz}"))
        _fly(plan)  # compiles
        rounds = sorted((_fly(plan).real_time_factor, _world_alone(plan)) for _ in range(ROUNDS))
        factor, alone = rounds[ROUNDS // 2]
        yield Row.of(
            f"lockstep flight, camera at {rate_hz:g} Hz",
            factor,
            "x real time",
            ("the world alone, no frames", alone),
            goal=goal,
            better="more",
        )


def _fly(plan: Plan) -> Summary:
    with tempfile.TemporaryDirectory() as folder:
        order = FlightOrder(
            plan=plan, plan_path=PLAN, vehicle="lockstep", camera="sitl", log_dir=Path(folder)
        )
        summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
    if summary.outcome != "flown":
        raise CompanionError(f"{PLAN}: flight {summary.outcome}: {summary.reason}")
    return summary


def _world_alone(plan: Plan) -> float:
    """Times real time of physics and autopilot on the ground."""
    room = room_path(plan, PLAN)
    world = build(room, plan.sitl, plan.seed, plan.camera.rate_hz).world
    began_s, began_wall_s = world.time_s, wall_s()
    world.advance_to(began_s + ALONE_S)
    return (world.time_s - began_s) / (wall_s() - began_wall_s)
