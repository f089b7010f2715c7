"""Flies every fault at every moment in every room, and holds what came of it against what was
expected: in lockstep on all cores, and a smaller matrix over MAVLink.
"""

import argparse
import itertools
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

from rich.console import Console

from companion.kernel.errors import CompanionError, PlanError
from tools.drawing import run
from tools.faults import lockstep, mavlink
from tools.faults.book import Book
from tools.faults.cases import CASES, MAVLINK_ONLY, ROOMS
from tools.faults.lockstep import Task
from tools.faults.results import Flown, table
from tools.progress import progress_bar

MAVLINK_ROOM, MAVLINK_MOMENT = "room1", "test"

Way = tuple[str, Sequence[Task], Callable[[Sequence[Task]], Iterable[Flown]]]
"""Its name, its flights, and how to fly them."""


def main(argv: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    return run("faults", lambda: _work(args))


def _work(args: argparse.Namespace) -> Iterator[str]:
    if not any(args.only in case.name for case in (*CASES, *MAVLINK_ONLY)):
        raise PlanError(f"--only {args.only}: no fault is called so; see tools/faults/cases.py")
    args.out.mkdir(parents=True, exist_ok=True)
    book = Book(args.out / "faults.csv")
    ways: tuple[Way, ...] = (
        ("lockstep", _tasks(args), partial(_fly_all, workers=args.workers)),
        ("mavlink", _mavlink_tasks(args), partial(map, mavlink.fly)),
    )
    flights = [flown for way in ways for flown in _fly_missing(book, *way)]
    lines = list(table(flights))
    (args.out / "faults.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    yield str(book.path)
    yield from lines
    n_bad = sum(not flown.good for flown in flights)
    yield f"{len(flights)} flights, {n_bad} not as they should be"
    if n_bad:
        raise CompanionError(f"{n_bad} flights not as they should be; see {args.out}/faults.csv")


def _tasks(args: argparse.Namespace) -> list[Task]:
    cases = [case for case in CASES if args.only in case.name]
    seeds = range(1, args.seeds + 1)
    return [
        Task(case, moment, room, seed)
        for case in cases
        for moment, room, seed in itertools.product(case.moments, args.rooms, seeds)
    ]


def _mavlink_tasks(args: argparse.Namespace) -> list[Task]:
    cases = [case for case in (*CASES, *MAVLINK_ONLY) if args.only in case.name]
    seeds = range(1, args.mavlink_seeds + 1)
    return [Task(case, MAVLINK_MOMENT, MAVLINK_ROOM, seed) for case in cases for seed in seeds]


def _fly_all(tasks: Sequence[Task], workers: int) -> Iterator[Flown]:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([lockstep.__name__])
    if tasks:
        with context.Pool(workers, initializer=lockstep.be_quiet, maxtasksperchild=50) as pool:
            yield from pool.imap(lockstep.fly, tasks)


def _fly_missing(
    book: Book, way: str, tasks: Sequence[Task], fly: Callable[[Sequence[Task]], Iterable[Flown]]
) -> Iterator[Flown]:
    """Flies what the book lacks, and says at once what is not as it should be."""
    console = Console(stderr=True)
    missing = book.missing(way, tasks)
    with progress_bar(console) as bar:
        task = bar.add_task(f"flights, {way}", total=len(missing))
        for flown in fly(missing):
            book.add(flown)
            bar.advance(task)
            if not flown.good:
                console.print(_complaint(flown), markup=False, highlight=False, soft_wrap=True)
    return book.of(way, tasks)


def _complaint(flown: Flown) -> str:
    return (
        f"{flown.way} {flown.room} seed {flown.seed}: {flown.case} ({flown.moment}): "
        f"{flown.observed}, not {flown.expected}; {flown.collisions} collisions, "
        f"{flown.lost_s:.1f} s lost; {flown.reason}"
    )


def _number(least: int) -> Callable[[str], int]:
    def number(text: str) -> int:
        if int(text) < least:
            raise ValueError(text)
        return int(text)

    return number


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.faults", description=__doc__)
    parser.add_argument("--seeds", type=_number(0), default=20, help="in lockstep; default: 20")
    parser.add_argument("--mavlink-seeds", type=_number(0), default=1, help="default: 1")
    parser.add_argument("--rooms", nargs="+", default=ROOMS, choices=ROOMS)
    parser.add_argument("--only", default="", metavar="WORDS", help="faults whose name has them")
    parser.add_argument("--out", type=Path, default=Path("logs/faults"))
    parser.add_argument(
        "--workers", type=_number(1), default=len(os.sched_getaffinity(0)), help="processes"
    )
    return parser


if __name__ == "__main__":
    sys.exit(main())
