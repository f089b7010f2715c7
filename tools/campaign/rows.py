"""The figures of one flight, and how a line of results.csv holds them."""

import csv
import io
from collections.abc import Iterable
from pathlib import Path

import msgspec

from companion.kernel.errors import RecordingError
from companion.summary import Outcome, Summary
from tools.campaign.plan import PlannedFlight


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One flight. Figures without a phase in their name are the test phase's.

    Empty where there is no such figure, nan where it is undefined.
    """

    id: str
    group: str
    scheme: str
    room: str
    seed: int
    outcome: Outcome
    reason: str = ""
    """Why it failed, in one line."""
    test_s: float | None = None
    overrides: int | None = None
    """None where stereo flies anyway, or may not help."""
    turns: int | None = None
    collisions: int | None = None
    distance_flown_m: float | None = None
    coverage_norm: float | None = None
    """Cells visited over the cells that the vehicle could visit."""
    mse: float | None = None
    tpr: float | None = None
    fpr: float | None = None
    auc: float | None = None
    threshold_px: float | None = None
    stereo_approaches: int | None = None
    """Of the whole flight, and so is all that follows."""
    mono_approaches: int | None = None
    stereo_flight_s: float | None = None
    mono_flight_s: float | None = None
    samples_learned: int | None = None
    flight_collisions: int | None = None
    minimum_clearance_m: float | None = None
    camera_faults: int | None = None
    """Named in flight, whether they were there or not."""
    sim_s: float | None = None
    wall_s: float | None = None


COLUMNS = Row.__struct_fields__


class Landed(msgspec.Struct, frozen=True):
    """What comes back of a flight; ``log`` is empty when nothing could fly."""

    row: Row
    log: bytes = b""


def row_of(flight: PlannedFlight, summary: Summary) -> Row:
    """The row of a flight that left a summary, flown to its end or not."""
    test, experiment = summary.phases["test"], flight.plan.experiment
    overridable = experiment.test_override and experiment.scheme != "pure_stereo"
    cells = test.cells_visited
    return Row(
        id=flight.id,
        group=flight.group,
        scheme=summary.scheme,
        room=summary.room,
        seed=summary.seed,
        outcome=summary.outcome,
        reason=one_line(summary.reason),
        test_s=test.stereo_flight_s + test.mono_flight_s,
        overrides=test.overrides if overridable else None,
        turns=test.turns,
        collisions=test.collisions,
        distance_flown_m=test.distance_flown_m,
        coverage_norm=None if cells is None else cells / flight.free_cells,
        mse=test.mse,
        tpr=test.tpr,
        fpr=test.fpr,
        auc=test.auc,
        threshold_px=summary.threshold_px,
        stereo_approaches=summary.stereo_approaches,
        mono_approaches=summary.mono_approaches,
        stereo_flight_s=summary.stereo_flight_s,
        mono_flight_s=summary.mono_flight_s,
        samples_learned=summary.samples_learned,
        flight_collisions=summary.collisions,
        minimum_clearance_m=summary.minimum_clearance_m,
        camera_faults=summary.camera_faults,
        sim_s=summary.sim_s,
        wall_s=summary.wall_s,
    )


def failed_row(flight: PlannedFlight, reason: str) -> Row:
    """The row of a flight that never took off."""
    return Row(
        id=flight.id,
        group=flight.group,
        scheme=flight.plan.experiment.scheme,
        room=flight.plan.room,
        seed=flight.seed,
        outcome="failed",
        reason=one_line(reason),
    )


def one_line(text: str) -> str:
    return " ".join(text.split())


def parse_rows(content: bytes, path: Path) -> list[Row]:
    """The whole lines of the file's content; a last one that was cut off is left out.

    Raises RecordingError for the content of another file.
    """
    if not content.startswith(HEADER[: len(content)]):
        raise RecordingError(f"{path}: not the results of a campaign of this version")
    whole = content[: content.rfind(b"\n") + 1].decode("utf-8", "replace")
    lines = csv.reader(io.StringIO(whole))
    next(lines, None)
    rows = []
    for number, cells in enumerate(lines, 2):
        named = dict(zip(COLUMNS, cells, strict=False))
        try:
            known = {name: cell for name, cell in named.items() if cell}
            rows.append(msgspec.convert(known, Row, strict=False))
        except msgspec.ValidationError as error:
            raise RecordingError(f"{path}: line {number}: {error}") from error
    return rows


def row_line(row: Row) -> bytes:
    values = [getattr(row, name) for name in COLUMNS]
    return csv_line("" if value is None else str(value) for value in values)


def csv_line(cells: Iterable[str]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerow(cells)
    return text.getvalue().encode()


HEADER = csv_line(COLUMNS)
