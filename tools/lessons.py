"""Flies a plan again and again, each flight with what the last one learned, and beside it without.

Shows what memory is worth: the error of the estimate before each frame is learned from, and the
overrides, flight by flight. A chain is one such series; flights of the same number and chain have
the same seed with memory and without. All flights are in lockstep.
"""

import argparse
import asyncio
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from companion.flight import FlightOrder, fly_plan
from companion.kernel.errors import CompanionError
from companion.plan import load_plan
from companion.summary import Summary, format_figure
from tools.drawing import run, save_figure, save_table

KINDS = ("with memory", "without")
COLOURS = {"with memory": "#0072b2", "without": "#d55e00"}


class Lesson(NamedTuple):
    """One flight of a chain; errors are mean squares in px², before learning from the frame."""

    kind: str
    chain: int
    flight: int
    seed: int
    mse_initial: float
    mse_learning: float
    mse_test: float
    overrides_learning: int
    overrides_test: int
    turns_test: int
    collisions: int


def main(argv: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    return run("lessons", lambda: _work(args))


def _work(args: argparse.Namespace) -> Iterator[str]:
    args.out.mkdir(parents=True)
    lessons: list[Lesson] = []
    for chain in range(1, args.chains + 1):
        for kind in KINDS:
            lessons += _fly_chain(args, chain, kind)
    yield str(save_table(args.out / "lessons.csv", Lesson._fields, lessons))
    yield from map(str, save_figure(_figure(lessons, args.flights), args.out / "lessons"))
    yield from _table(lessons, args.flights)


def _fly_chain(args: argparse.Namespace, chain: int, kind: str) -> Iterator[Lesson]:
    model: Path | None = None
    for flight in range(1, args.flights + 1):
        seed = args.seed + (chain - 1) * args.flights + flight - 1
        folder = args.out / f"{kind.replace(' ', '-')}-{chain}-{flight:02d}"
        folder.mkdir()
        order = FlightOrder(
            plan=load_plan(args.plan, args.set or (), seed),
            plan_path=args.plan,
            vehicle="lockstep",
            log_dir=folder,
            model=model,
        )
        summary = asyncio.run(fly_plan(order, lambda step, pipeline: None))
        if summary.outcome != "flown":
            raise CompanionError(f"{folder}: flight {summary.outcome}: {summary.reason}")
        model = folder if kind == KINDS[0] else None
        yield _lesson(kind, chain, flight, summary)


def _lesson(kind: str, chain: int, flight: int, summary: Summary) -> Lesson:
    initial, learning, test = (summary.phases[name] for name in ("initial", "learning", "test"))
    return Lesson(
        kind=kind,
        chain=chain,
        flight=flight,
        seed=summary.seed,
        mse_initial=initial.mse,
        mse_learning=learning.mse,
        mse_test=test.mse,
        overrides_learning=learning.overrides,
        overrides_test=test.overrides,
        turns_test=test.turns,
        collisions=summary.collisions or 0,
    )


def _mean(lessons: Sequence[Lesson], kind: str, flight: int, *fields: str) -> float:
    """Of the sum of these fields, over the chains."""
    chosen = [lesson for lesson in lessons if (lesson.kind, lesson.flight) == (kind, flight)]
    return float(np.mean([sum(getattr(lesson, name) for name in fields) for lesson in chosen]))


def _figure(lessons: Sequence[Lesson], n_flights: int) -> Figure:
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    overrides_axes, error_axes = figure.subplots(1, 2)
    flights = range(1, n_flights + 1)
    for kind in KINDS:
        overrides = [
            _mean(lessons, kind, n, "overrides_learning", "overrides_test") for n in flights
        ]
        errors = [_mean(lessons, kind, n, "mse_learning") for n in flights]
        overrides_axes.plot(flights, overrides, "o-", color=COLOURS[kind], label=kind)
        error_axes.plot(flights, errors, "o-", color=COLOURS[kind], label=kind)
    overrides_axes.set(xlabel="flight", ylabel="overrides while learning and in the test", ylim=0)
    error_axes.set(xlabel="flight", ylabel="error while learning, px²", ylim=0)
    error_axes.legend(frameon=False)
    return figure


def _table(lessons: Sequence[Lesson], n_flights: int) -> Iterator[str]:
    """Markdown: means over the chains, with memory / without."""
    columns = {
        "MSE initial, px²": ("mse_initial",),
        "MSE learning, px²": ("mse_learning",),
        "MSE test, px²": ("mse_test",),
        "overrides learning": ("overrides_learning",),
        "overrides test": ("overrides_test",),
        "turns test": ("turns_test",),
        "collisions": ("collisions",),
    }
    yield f"| flight | {' | '.join(columns)} |"
    yield "|" + "---|" * (len(columns) + 1)
    for flight in range(1, n_flights + 1):
        cells = [
            " / ".join(format_figure(_mean(lessons, kind, flight, *fields)) for kind in KINDS)
            for fields in columns.values()
        ]
        yield f"| {flight} | {' | '.join(cells)} |"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.lessons", description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--flights", type=int, default=10, help="of each chain; default: 10")
    parser.add_argument("--chains", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1, help="of the first flight")
    parser.add_argument("--set", nargs="+", metavar="KEY=VALUE", help="keys of the plan")
    parser.add_argument("--out", type=Path, default=Path("logs/lessons"), help="a new folder")
    return parser


if __name__ == "__main__":
    sys.exit(main())
