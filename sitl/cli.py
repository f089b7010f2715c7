"""The command line: ``sitl run ROOM``."""

import gc
import logging
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from companion.kernel.clock import unix_s
from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError, PlanError
from sitl.build import build, build_follower
from sitl.conditions import CLEAR, LinkConditions, link_rng
from sitl.console import VERBS, Console, ask, refused
from sitl.mavlink.camera import CameraDescription
from sitl.mavlink.link_url import parse_link
from sitl.mavlink.links import Link, impair, open_link
from sitl.mavlink.parameter_file import ParameterFile
from sitl.mavlink.poses import PoseListener
from sitl.mavlink.server import MavlinkServer
from sitl.mavlink.signing import Keyring, read_key
from sitl.mavlink.tlog import TelemetryLog
from sitl.options import read_settings, spread_links
from sitl.pace import FASTEST, SLOWEST, Pace
from sitl.parent import Parent, ReadyLine
from sitl.server import CameraServer, RealTimeServer, follow

DEFAULT_MAVLINK = "udpout://127.0.0.1:14540?local_port=14580"
DEFAULT_CAMERA = "tcp://127.0.0.1:14590"

app = typer.Typer(
    help="A multirotor with a stereo camera in a textured room, made of software.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def _setup(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Log more to stderr.")] = False,
) -> None:
    level = logging.INFO if verbose else logging.WARNING
    logging.basicConfig(level=level, format="%(levelname)s %(name)s: %(message)s")


@app.command()
def run(
    room: Annotated[Path, typer.Argument(help="Room (TOML); see flightplans/rooms.")],
    mavlink: Annotated[
        list[str] | None,
        typer.Option(
            metavar="URL",
            help="udpout://HOST:PORT[?local_port=PORT] speaks first; udpin://[HOST]:PORT and "
            "tcpin://[HOST]:PORT wait for clients, of this machine alone without a HOST; "
            "serial:///dev/DEVICE[:BAUD]; each with ?profile=gcs for a ground station's rates, UDP "
            "with loss_norm, latency_s, jitter_s, duplicate_norm for a bad link. "
            f"Several after one option, or many times. [default: {DEFAULT_MAVLINK}]",
        ),
    ] = None,
    camera: Annotated[
        str, typer.Option(metavar="URL", help="Where stereo frames are published; port 0: any.")
    ] = DEFAULT_CAMERA,
    camera_rate: Annotated[float, typer.Option(metavar="HZ", help="Frames per second.")] = 10.0,
    speed: Annotated[float, typer.Option(min=SLOWEST, max=FASTEST, help="Times real time.")] = 1.0,
    paused: Annotated[
        bool, typer.Option("--paused", help="Begin with time standing still.")
    ] = False,
    control: Annotated[
        str | None,
        typer.Option(
            metavar="URL", help="tcp://HOST:PORT that `sitl control` talks to; port 0: any."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    settings: Annotated[
        Path | None, typer.Option(help="The plan's [sitl] table, as a TOML or JSON file.")
    ] = None,
    home: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON[,ALT]", help="Of the start: degrees, metres above the sea."),
    ] = None,
    param: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="A parameter of the autopilot, many times."),
    ] = None,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JSON",
            help="What goes wrong, and when: "
            '{"at_s": 20, "failures": {"optical_flow": "off"}}. May be given many times.',
        ),
    ] = None,
    parameters: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Saved parameters: read now, written when asked to."),
    ] = None,
    signing_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Obey only messages signed with this key."),
    ] = None,
    log_dir: Annotated[
        Path | None, typer.Option(help="Existing folder for flight.tlog, the first link's log.")
    ] = None,
    until_stdin_closes: Annotated[
        bool,
        typer.Option(
            help="For a parent process: take faults as lines of JSON on stdin, end when it closes."
        ),
    ] = False,
) -> None:
    """Fly in real time until SIGINT or SIGTERM.

    When ready, prints one line of JSON on stdout: {"ready": true, "mavlink": [URL, ...], "camera":
    URL, "control": URL}, with the ports that were really taken.
    """
    if paused and control is None:
        raise PlanError("--paused: nothing could make time go on; add --control URL")
    stop = _stopped_by_signals()
    with ExitStack() as open_things:
        keyring = Keyring(read_key(signing_key), unix_s) if signing_key else None
        saved = ParameterFile(parameters) if parameters else None
        urls = mavlink or [DEFAULT_MAVLINK]
        links = [_closed_by(open_things, open_link(url)) for url in urls]
        table = read_settings(settings, home, param or (), fault or ())
        simulation = build(room, table, seed, camera_rate)
        world = simulation.world
        impair(links, _conditions(urls, world.link, seed), lambda: world.time_s)
        calibration = simulation.camera.calibration
        frames = CameraServer(camera, calibration)
        open_things.callback(frames.close)
        vehicle = MavlinkServer(
            world.autopilot,
            links,
            TelemetryLog(log_dir / "flight.tlog") if log_dir else None,
            camera=CameraDescription(calibration, camera_rate, frames.url),
            keyring=keyring,
            parameter_file=saved,
            origin=simulation.home,
        )
        open_things.callback(vehicle.close)
        pace = Pace(speed, paused=paused)
        console = Console(control, world, pace) if control else None
        if console is not None:
            open_things.callback(console.close)
        server = RealTimeServer(
            world, simulation.camera, vehicle, frames, camera_rate, pace, console
        )
        _say_ready(links, frames, console)
        parent = Parent(world) if until_stdin_closes else None
        server.run(lambda: stop.is_set() or (parent is not None and parent.has_gone()))


@app.command()
def arena(
    room: Annotated[Path, typer.Argument(help="Room (TOML); see flightplans/rooms.")],
    pose: Annotated[
        str,
        typer.Option(
            metavar="URL",
            help="Link of the autopilot that flies: udpin://HOST:PORT waits for it, "
            "udpout://HOST:PORT speaks first.",
        ),
    ],
    camera: Annotated[
        str, typer.Option(metavar="URL", help="Where stereo frames are published; port 0: any.")
    ] = DEFAULT_CAMERA,
    camera_rate: Annotated[float, typer.Option(metavar="HZ", min=1, max=120)] = 10.0,
    rest_height: Annotated[
        float, typer.Option(metavar="M", min=0, help="Of the vehicle's centre above its feet.")
    ] = 0.06,
    seed: Annotated[int, typer.Option(min=0, help="Of everything random.")] = 0,
    settings: Annotated[
        Path | None, typer.Option(help="The plan's [sitl] table, as a TOML or JSON file.")
    ] = None,
    until_stdin_closes: Annotated[
        bool, typer.Option(help="For a parent process: end when stdin closes.")
    ] = False,
) -> None:
    """Put the room around another autopilot until SIGINT or SIGTERM.

    Poses come from HIL_STATE_QUATERNION, else ODOMETRY, else LOCAL_POSITION_NED and ATTITUDE.
    Prints the same line as `sitl run` when ready, and at the end one with the count of collisions.
    """
    stop = _stopped_by_signals()
    with ExitStack() as open_things:
        listener = PoseListener(pose)
        open_things.callback(listener.close)
        follower = build_follower(room, read_settings(settings), seed, camera_rate, rest_height)
        frames = CameraServer(camera, follower.calibration)
        open_things.callback(frames.close)
        typer.echo(msgspec.json.encode(ReadyLine(mavlink=[listener.url], camera=frames.url)))
        parent = Parent() if until_stdin_closes else None
        follow(
            listener,
            follower,
            frames,
            lambda: stop.is_set() or (parent is not None and parent.has_gone()),
        )
        source = None if listener.source is None else listener.source.name
        typer.echo(msgspec.json.encode(follower.visit(source)))


@app.command()
def control(
    url: Annotated[str, typer.Argument(help="The control URL that `sitl run` printed.")],
    lines: Annotated[list[str], typer.Argument(help=f"Each one of: {VERBS}.")],
) -> None:
    """Pause a running `sitl run`, step it, change its speed; prints an answer for each line."""
    for answer in ask(url, lines):
        typer.echo(answer)
        if refused(answer):
            raise typer.Exit(EXIT_FAILED)


def _say_ready(links: Sequence[Link], frames: CameraServer, console: Console | None) -> None:
    gc.collect()
    gc.freeze()  # what lives until now lives to the end; looking through it costs milliseconds
    ready = ReadyLine(
        mavlink=[link.url for link in links],
        camera=frames.url,
        control=console.url if console is not None else msgspec.UNSET,
    )
    typer.echo(msgspec.json.encode(ready))


def _stopped_by_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda _number, _frame: stop.set())
    return stop


def _closed_by(stack: ExitStack, link: Link) -> Link:
    stack.callback(link.close)
    return link


def _conditions(urls: Sequence[str], first: LinkConditions, seed: int) -> list[LinkConditions]:
    """One for each link, as its URL says; the first is the companion's and has its settings."""
    wanted = [parse_link(url).conditions for url in urls]
    first.settings = first.settings if wanted[0] == CLEAR else wanted[0]
    others = enumerate(wanted[1:], start=1)
    return [first, *(LinkConditions(state, link_rng(seed, number)) for number, state in others)]


def main(argv: Sequence[str] | None = None) -> int:
    """The console script; returns the exit code."""
    try:
        app(spread_links(sys.argv[1:] if argv is None else argv), prog_name="sitl")
    except SystemExit as end:  # typer has said what was wrong with the words
        return end.code if isinstance(end.code, int) else EXIT_FAILED
    except CompanionError as error:
        typer.echo(f"sitl: {error}", err=True)
        return error.exit_code
    return EXIT_FLOWN
