"""What a person sees while a flight runs, and its result; all of it on stderr but the table."""

import math
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from companion.kernel.clock import wall_s
from companion.kernel.messages import Cue, Decision
from companion.learning_report import LearningReport
from companion.pipeline import Pipeline, Step
from companion.summary import Summary, format_figure, table_rows

REDRAW_PERIOD_S = 0.25
PLAIN_PERIOD_SIM_S = 30.0
CUE_STYLE = {
    Cue.STEREO: "bold cyan",
    Cue.MONO: "bold green",
    Cue.FUSED: "bold blue",
    Cue.NONE: "bold red",
}


class Progress:
    """A live table on a terminal; elsewhere (CI, a file) a plain line every 30 s of the flight."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = (
            Live(Text("taking off"), console=console, auto_refresh=False)
            if console.is_terminal
            else None
        )
        self._began_ns: int | None = None
        self._began_wall_s = 0.0
        self._drawn_wall_s = -math.inf
        self._drawn_sim_s = -math.inf

    def __enter__(self) -> Self:
        if self._live:
            self._live.start(refresh=True)
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._live:
            self._live.stop()

    def show(self, step: Step, pipeline: Pipeline) -> None:
        """Called for every frame; draws now and then."""
        now_s = wall_s()
        if self._began_ns is None:
            self._began_ns, self._began_wall_s = step.percept.stamp_ns, now_s
        sim_s = (step.percept.stamp_ns - self._began_ns) * 1e-9
        elapsed_s = now_s - self._began_wall_s
        factor = sim_s / elapsed_s if elapsed_s > 0 else math.nan
        if self._live and now_s - self._drawn_wall_s >= REDRAW_PERIOD_S:
            self._live.update(_status_table(step, pipeline, sim_s, factor), refresh=True)
            self._drawn_wall_s = now_s
        elif not self._live and sim_s - self._drawn_sim_s >= PLAIN_PERIOD_SIM_S:
            self._console.print(_status_line(step, sim_s, factor), highlight=False, soft_wrap=True)
            self._drawn_sim_s = sim_s


def print_result(console: Console, summary: Summary, log_dir: str) -> None:
    """The paper's Table II column of this flight, and where the log lies."""
    console.print(
        f"{summary.plan}, seed {summary.seed}, {summary.scheme}", highlight=False, soft_wrap=True
    )
    table = Table()
    table.add_column("")
    table.add_column("this flight", justify="right")
    for name, value in table_rows(summary):
        table.add_row(name, value)
    console.print(table)
    console.print(
        f"{summary.outcome} in {summary.sim_s:.0f} s of flight, {summary.wall_s:.0f} s of wall "
        f"time ({_factor(summary.real_time_factor)}); log: {log_dir}",
        highlight=False,
        soft_wrap=True,
    )


def print_learning(console: Console, report: LearningReport) -> None:
    """How well one eye learned from recordings."""
    table = Table(title="one eye against two")
    table.add_column("")
    table.add_column("", justify="right")
    rows = {
        "Positive: λ above, px": format_figure(report.positive_threshold_px),
        "Frames read": str(report.n_frames),
        "Frames learned from": str(report.n_train),
        "Frames scored": str(report.n_test),
        "Mean square error, px²": format_figure(report.mse),
        "MSE over variance": format_figure(report.mse_over_variance),
        "Area under the ROC curve": format_figure(report.auc),
        f"True positive rate above {report.threshold_px:.2f} px": format_figure(report.tpr),
        f"False positive rate above {report.threshold_px:.2f} px": format_figure(report.fpr),
        "False positive rate at TPR 0.96": format_figure(report.fpr_at_tpr_0_96),
        "Errors within 50 / 80 / 95 % intervals": " / ".join(
            format_figure(share)
            for share in (report.coverage_0_5, report.coverage_0_8, report.coverage_0_95)
        ),
        "Area under the ROC curve of large errors by spread": format_figure(report.auc_of_error),
        "Novelty, median": format_figure(report.novelty_median),
        "Frames with a novelty above 1": format_figure(report.novel_norm),
    }
    if report.map is not None:
        figure = format_figure(report.map.mse_over_variance_of_all)
        rows["MSE over variance, all cells of the maps"] = figure
    for name, value in rows.items():
        table.add_row(name, value)
    console.print(table)


def _status_table(step: Step, pipeline: Pipeline, sim_s: float, factor: float) -> Table:
    """Pairs of label and value, three a row; the widths are fixed, so that nothing jumps."""
    decision, percept = step.decision, step.percept
    experiment = pipeline.plan.experiment
    total_s = experiment.initial_s + experiment.learning_s + experiment.test_s
    table = Table.grid(padding=(0, 2))
    for width, style in ((6, "dim"), (14, ""), (8, "dim"), (17, ""), (9, "dim"), (8, "")):
        table.add_column(width=width, style=style, no_wrap=True)
    flight = f"{sim_s:.0f} of {total_s:.0f} s"
    state, turns, overrides = decision.state.value, str(decision.turns), str(decision.overrides)
    table.add_row("phase", decision.phase.value, "λ stereo", _px(percept.stereo_px), "state", state)
    table.add_row("flight", flight, "λ mono", _px(percept.mono_px), "turns", turns)
    table.add_row("speed", _factor(factor), "flies on", _cue(decision), "overrides", overrides)
    certainty = f"{decision.certainty_norm:.0%}"
    table.add_row("", "", "mono is", decision.trust.value, "certainty", certainty)
    return table


def _cue(decision: Decision) -> Text:
    if decision.override:
        return Text("stereo (override)", style="bold red")
    return Text(decision.cue.value, CUE_STYLE[decision.cue])


def _status_line(step: Step, sim_s: float, factor: float) -> str:
    decision, percept = step.decision, step.percept
    return (
        f"{sim_s:5.0f} s  {decision.phase.value:<8}  λ stereo {_px(percept.stereo_px)}  "
        f"mono {_px(percept.mono_px)} {decision.trust.value:<9}  {decision.cue.value:<6}  "
        f"{decision.state.value:<8}  "
        f"turns {decision.turns:2d}  overrides {decision.overrides:2d}  {_factor(factor)}"
    )


def _px(value: float) -> str:
    return "   – px" if math.isnan(value) else f"{value:4.1f} px"


def _factor(value: float) -> str:
    """Times real time; unknown at the first frame."""
    return "–" if math.isnan(value) else f"{value:.1f}x"
