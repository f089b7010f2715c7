"""Runs a study on recordings and prints its table; the same command goes on where it ended.

python -m tools.offline flightplans/studies/textons.toml RECORDING ... [--out DIR] [--json]
python -m tools.offline flightplans/studies RECORDING ...

The second runs all studies of a folder. A RECORDING is what companion learn takes, or a folder of
them. Writes NAME.csv (a line per run),
NAME.json (means), NAME.png and NAME.svg. Images, λ, features and finished runs are kept in --cache.
"""

import argparse
import os
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from rich.console import Console

from companion.kernel.clock import unix_s
from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError
from tools.arguments import count
from tools.drawing import save_figure
from tools.offline.figure import draw
from tools.offline.run import run_study
from tools.offline.store import find_recordings
from tools.offline.study import Study, find_studies, load_study
from tools.offline.table import (
    Provenance,
    Report,
    encode,
    print_report,
    summarise,
    write_tables,
)

COLUMNS = 160
"""That the table gets, however narrow the terminal."""


def conduct(
    study: Study, options: argparse.Namespace, words: Sequence[str]
) -> tuple[Report, list[Path]]:
    """Runs a study; returns what it found and the files that tell it. Raises CompanionError."""
    rows, recordings = run_study(
        study,
        find_recordings(options.recordings),
        options.cache,
        options.workers,
        Console(stderr=True),
    )
    made = Provenance(
        command=shlex.join(["python", "-m", "tools.offline", *words]),
        date=datetime.fromtimestamp(unix_s(), UTC).date().isoformat(),
        seeds=study.settings.seeds,
        recordings={recording.name: len(recording) for recording in recordings},
    )
    report = Report(study.name, study.settings.question, made, summarise(rows))
    folder = options.out or Path("logs") / f"offline-{study.name}"
    files = write_tables(folder, study, rows, report)
    return report, files + save_figure(draw(report), folder / study.name, dpi=90)


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: done, 1: a trial failed or the study was stopped, 2: usage."""
    words = sys.argv[1:] if argv is None else argv
    options = _parser().parse_args(words)
    try:
        # All are read before the first is measured: a mistake shows at once.
        for study in [load_study(path) for path in find_studies(options.study)]:
            _show(*conduct(study, options, words), as_json=options.json)
    except CompanionError as error:
        print(f"offline: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"offline: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print("offline: stopped; the same command goes on from here", file=sys.stderr)
        return EXIT_FAILED
    return EXIT_FLOWN


def _show(report: Report, files: Sequence[Path], as_json: bool) -> None:
    if as_json:
        sys.stdout.write(encode(report).decode())
        return
    print_report(Console(width=max(Console().width, COLUMNS)), report)
    print(*files, sep="\n", flush=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.offline",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("study", type=Path, help="study file (TOML), or a folder of them")
    parser.add_argument("recordings", type=Path, nargs="+", metavar="RECORDING")
    parser.add_argument("--out", type=Path, help="default: logs/offline-STUDY")
    parser.add_argument("--cache", type=Path, default=Path("logs/offline-cache"))
    parser.add_argument(
        "--workers",
        type=count,
        default=len(os.sched_getaffinity(0)),
        help="processes; default: one per core",
    )
    parser.add_argument("--json", action="store_true", help="print the summary, not the table")
    return parser


if __name__ == "__main__":
    sys.exit(main())
