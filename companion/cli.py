"""The command line: ``companion fly`` and ``companion learn``.

The commands import what they need when they run: that takes two seconds, which neither ``--help``
nor a slip of the finger should cost, and an interrupt meanwhile ends in one line.
"""

import asyncio
import faulthandler
import logging
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import typer
from rich.console import Console

from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError, PlanError

if TYPE_CHECKING:
    from companion.learning_report import LearningReport

STDERR = 2
_INTERRUPTED = 130
"""What typer makes of a KeyboardInterrupt."""

app = typer.Typer(
    help="Fly on two eyes, learn to fly on one: a companion for vision-based drones.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

PlanArgument = Annotated[
    Path, typer.Argument(help="Flight plan (TOML); see flightplans/README.md.")
]
VehicleOption = Annotated[
    str,
    typer.Option(
        help="sitl: own process, through MAVLink; lockstep: in this process, on simulated "
        "time; or the MAVLink URL of any autopilot, e.g. udpin://0.0.0.0:14540."
    ),
]
CameraOption = Annotated[
    str,
    typer.Option(help="sitl; a frame server's tcp:// URL; device:N?calibration=FILE; a path."),
]
PositiveOption = Annotated[
    float | None, typer.Option(help="λ of a positive [px]; default: the plan's threshold.")
]
ModelOption = Annotated[
    Path | None,
    typer.Option(
        help="Begin with what an earlier flight learned: a model.npz, a flight's folder, or a "
        "folder of flights, of which the newest counts."
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a key of the plan; may be given many times."
    ),
]


class StderrHandler(logging.Handler):
    """Log lines to the stderr of the moment: above the live table while that is drawn."""

    def emit(self, record: logging.LogRecord) -> None:
        sys.stderr.write(self.format(record) + "\n")


@app.callback()
def _setup(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more to stderr.")] = False,
) -> None:
    faulthandler.enable(STDERR)  # a watchdog's SIGABRT shows where it hung
    level = logging.DEBUG if verbose else logging.WARNING
    logging.basicConfig(
        level=level, format="%(levelname)s %(name)s: %(message)s", handlers=[StderrHandler()]
    )


@app.command()
def fly(
    plan: PlanArgument,
    vehicle: VehicleOption = "sitl",
    camera: CameraOption = "sitl",
    speed: Annotated[
        float, typer.Option(min=0.1, max=100, help="Times real time; 1 for real vehicles.")
    ] = 1.0,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the plan's seed.")] = None,
    log_dir: Annotated[Path, typer.Option(help="Log folders are made in here.")] = Path("logs"),
    model: ModelOption = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Take over a vehicle in the air, and go on with the flight that was interrupted.",
        ),
    ] = False,
    settings: SetOption = None,
) -> None:
    """Fly a plan: take off, learn, be tested, land; leaves a log folder.

    Exit code 0: flown, 1: the flight failed (one line says why), 2: usage or plan error.
    """
    from companion.console import Progress, print_result
    from companion.flight import FlightOrder, fly_plan
    from companion.logfolder import new_log_dir
    from companion.plan import load_plan
    from companion.supervisor import Supervisor

    loaded = load_plan(plan, settings or (), seed)
    supervisor = Supervisor.from_environment(os.environ)
    order = FlightOrder(
        plan=loaded,
        plan_path=plan,
        vehicle=vehicle,
        camera=camera,
        speed=speed,
        log_dir=new_log_dir(log_dir, loaded, plan),
        model=model,
        resume=resume,
    )
    with Progress(Console(stderr=True)) as progress:
        summary = asyncio.run(fly_plan(order, progress.show, supervisor=supervisor))
    print_result(Console(), summary, str(order.log_dir))
    if summary.outcome != "flown":
        raise CompanionError(f"flight {summary.outcome}: {summary.reason}")


@app.command()
def learn(
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Predict each pair first, then learn from it.")
    ] = None,
    plan: Annotated[Path | None, typer.Option(help="Stereo and learner settings.")] = None,
    train: Annotated[list[Path] | None, typer.Option(help="Learn on these, then freeze.")] = None,
    test: Annotated[list[Path] | None, typer.Option(help="Score on these.")] = None,
    positive_threshold: PositiveOption = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the figures here.")
    ] = None,
    settings: SetOption = None,
) -> None:
    """Learn from recorded stereo pairs, without a vehicle, and say how well it went.

    A recording is a folder in the EuRoC/ASL layout or with left/ and right/, a flight.mcap with
    images or a side-by-side video.
    """
    from companion.camera.recording import open_recordings
    from companion.console import print_learning
    from companion.learn import run_prequential, run_train_test
    from companion.plan import load_plan

    loaded = load_plan(plan, settings or ())
    folder = plan.parent if plan else Path()
    positive_px = positive_threshold or loaded.behaviour.turn_threshold_px
    if train or test:
        if recordings or not (train and test):
            raise PlanError("give recordings to learn from in order, or both --train and --test")
        report = run_train_test(
            open_recordings(train), open_recordings(test), loaded, positive_px, folder
        )
    elif recordings:
        report = run_prequential(open_recordings(recordings), loaded, positive_px, folder)
    else:
        raise PlanError("no recording given; see companion learn --help")
    print_learning(Console(), report)
    if json_file:
        _write_json(json_file, report)


def _write_json(path: Path, report: "LearningReport") -> None:
    try:
        path.write_bytes(msgspec.json.format(msgspec.json.encode(report), indent=2) + b"\n")
    except OSError as error:
        raise CompanionError(f"--json {path}: cannot be written: {error.strerror}") from error


def _spread(arguments: Sequence[str]) -> list[str]:
    """``--train A B`` becomes ``--train A --train B``, which is all that click understands."""
    spread: list[str] = []
    option = ""
    for argument in arguments:
        if argument.startswith("-"):
            option = argument if argument in ("--train", "--test", "--set") else ""
        elif option and spread[-1] != option:
            if option != "--set" or "=" in argument:
                spread.append(option)
            else:
                option = ""
        spread.append(argument)
    return spread


def main(argv: Sequence[str] | None = None) -> int:
    """The console script; returns the exit code."""
    arguments = _spread(sys.argv[1:] if argv is None else argv)
    try:
        app(arguments, prog_name="companion")
    except SystemExit as end:
        if end.code == _INTERRUPTED:
            typer.echo("companion: interrupted", err=True)
            return EXIT_FAILED
        # typer has said what was wrong with the words
        return end.code if isinstance(end.code, int) else EXIT_FAILED
    except CompanionError as error:
        typer.echo(f"companion: {error}", err=True)
        return error.exit_code
    return EXIT_FLOWN
