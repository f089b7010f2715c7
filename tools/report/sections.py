"""What a flight's report holds, in order. A new figure is one line in FIGURES."""

import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from typing import NamedTuple

from matplotlib.figure import Figure

from companion.flightlog import Topic
from companion.kernel.errors import CompanionError
from companion.summary import format_figure, table_rows
from tools import picture, risk
from tools.assessment import assess
from tools.logs import open_log
from tools.report import figures
from tools.report.flight import ReportedFlight, overrides
from tools.report.page import Page, paragraph, table
from tools.report.plans import plan_flown

PACKAGES = (
    "mono-companion", "numpy", "opencv-python-headless", "scikit-learn", "numba", "mcap", "mavsdk",
    "pymavlink", "jsbsim", "matplotlib",
)  # fmt: skip


class FigureSection(NamedTuple):
    """``draw`` raises CompanionError for a flight that it cannot show; the report says why."""

    title: str
    name: str
    """Of its files."""
    draw: Callable[[ReportedFlight], Figure]


FIGURES: list[FigureSection] = [
    FigureSection("Path", "path", lambda flight: picture.draw(flight, flight.room)),
    FigureSection("λ over time", "disparity", figures.disparity_strips),
    FigureSection("ROC curve", "roc", figures.roc_curves),
    FigureSection("λ along the path", "flightpath", figures.six_panels),
    FigureSection("The vehicle's own log", "vehicle", figures.vehicle_log),
]


def flight_page(flight: ReportedFlight, page: Page) -> None:
    """Fills the page. Raises CompanionError for a log that is damaged inside."""
    page.add("Outcome", _outcome(flight))
    page.add("Table II", table(("", "this flight"), table_rows(flight.summary)))
    page.add("Phases", _phases(flight))
    page.add("Overrides", _overrides(flight))
    for section in FIGURES:
        page.add(section.title, _drawn(section, flight, page))
    page.add("Risk", _risk(flight))
    page.add("Events", _events(flight))
    page.add("Health of the log", _health(flight))
    page.add("Plan as flown", plan_flown(flight))
    page.add("Software", _software(flight))


def _outcome(flight: ReportedFlight) -> str:
    summary = flight.summary
    said = f"{summary.outcome}: {summary.reason}" if summary.reason else summary.outcome
    clearance = summary.minimum_clearance_m
    rows = [
        ("plan", f"{summary.plan}, room {summary.room or 'unknown'}, seed {summary.seed}"),
        ("scheme", summary.scheme),
        ("flight time", f"{summary.sim_s:.0f} s, {summary.frames} frames"),
        ("frames dropped", str(summary.frames_dropped)),
        ("camera faults", str(summary.camera_faults)),
        ("samples learned", str(summary.samples_learned)),
        ("collisions", "unknown" if summary.collisions is None else str(summary.collisions)),
        ("least clearance", "unknown" if clearance is None else f"{clearance:.2f} m"),
        ("log", str(flight.path.name)),
    ]
    return paragraph(said, summary.outcome) + table(("", ""), rows, words=True)


def _phases(flight: ReportedFlight) -> str:
    header = (
        "", "stereo, s", "mono, s", "stereo approaches", "mono approaches", "turns", "overrides",
        "MSE, px²", "TPR", "FPR", "AUC",
    )  # fmt: skip
    rows = [
        (
            name,
            f"{phase.stereo_flight_s:.0f}",
            f"{phase.mono_flight_s:.0f}",
            str(phase.stereo_approaches),
            str(phase.mono_approaches),
            str(phase.turns),
            str(phase.overrides),
            *(format_figure(value) for value in (phase.mse, phase.tpr, phase.fpr, phase.auc)),
        )
        for name, phase in flight.summary.phases.items()
    ]
    return table(header, rows)


def _overrides(flight: ReportedFlight) -> str:
    header = (
        "phase", "at, s", "for, s", "north, m", "east, m", "stereo λ, px", "mono λ, px",
        "mono turns above, px",
    )  # fmt: skip
    rows = [
        (
            event.phase,
            f"{event.time_s:.1f}",
            f"{event.duration_s:.1f}",
            *(f"{metres:.2f}" for metres in event.place_m),
            *map(format_figure, (event.stereo_px, event.mono_px, event.mono_threshold_px)),
        )
        for event in overrides(flight)
    ]
    return table(header, rows) if rows else paragraph("none", "quiet")


def _drawn(section: FigureSection, flight: ReportedFlight, page: Page) -> str:
    try:
        return page.figure(section.draw(flight), section.name)
    except CompanionError as error:
        return _not_shown(error)


def _not_shown(error: CompanionError) -> str:
    return paragraph(f"not shown: {error}", "quiet")


def _risk(flight: ReportedFlight) -> str:
    """The performance model's figures beside what was observed."""
    try:
        told = assess(flight)
    except CompanionError as error:
        return _not_shown(error)
    figures = table(risk.HEADER, risk.table_rows(told))
    return paragraph(risk.conditions(told)) + figures + paragraph(risk.footnote(told), "quiet")


def _events(flight: ReportedFlight) -> str:
    """What the companion had to say in flight, on the time of the figures."""
    if Topic.EVENT not in flight.log.topics():
        return paragraph("none", "quiet")
    events = flight.log.columns(Topic.EVENT)
    since_s = (flight.log.log_times_ns(Topic.EVENT) - flight.percept["stamp_ns"][0]) * 1e-9
    said = zip(events["severity"].tolist(), events["text"].tolist(), strict=True)
    rows = [(f"{at_s:.1f}", *words) for at_s, words in zip(since_s, said, strict=True)]
    return table(("at, s", "", ""), rows, words=True)


def _health(flight: ReportedFlight) -> str:
    parts = []
    for path in (flight.path, *flight.logs_beside):
        try:
            health = open_log(path).examine()
        except CompanionError as error:
            parts.append(paragraph(str(error), "problem"))
            continue
        word, kind = ("sound", "sound") if health.sound else ("not sound", "problem")
        total = sum(health.records.values())
        parts.append(paragraph(f"{path.name}: {word}, {total} records", kind))
        rows = [("problem" if f.problem else "note", f.text) for f in health.findings]
        parts.append(table(("", ""), rows, words=True))
    return "\n".join(parts)


def _software(flight: ReportedFlight) -> str:
    rows = [("companion that flew", flight.log.metadata.version)]
    rows += [("report: Python", platform.python_version())]
    rows += [(f"report: {name}", _version(name)) for name in PACKAGES]
    return table(("", ""), rows, words=True)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
