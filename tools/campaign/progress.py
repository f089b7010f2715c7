"""What a person sees while a campaign runs; all of it on stderr."""

from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from companion.kernel.clock import wall_s
from tools.campaign.plan import PlannedFlight
from tools.campaign.rows import Row


class CampaignProgress:
    """A bar on a terminal; elsewhere a line per flight. Failed flights are a line everywhere."""

    def __init__(self, console: Console, planned: int, flown_before: int) -> None:
        self.failed = 0
        """Flights that failed, and flights that were lost."""
        self._console = console
        self._planned = planned
        self._before = flown_before
        self._ended = flown_before
        self._flown_sim_s = 0.0
        self._began_wall_s = wall_s()
        self._bar = Progress(
            BarColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("", total=planned, completed=flown_before)

    def __enter__(self) -> Self:
        self._bar.start()
        if self._before:
            self._say(f"{self._before} of {self._planned} flights are there already")
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._bar.stop()

    def landed(self, row: Row) -> None:
        self._flown_sim_s += row.sim_s or 0.0
        failed = row.outcome != "flown"
        told = row.reason if failed else f"{row.outcome}, {row.turns} turns"
        if row.overrides is not None and not failed:
            told += f", {row.overrides} overrides"
        self._end(row.group, row.seed, told, failed)

    def lost(self, flight: PlannedFlight, why: str) -> None:
        self._end(flight.group, flight.seed, f"not flown: {why}", failed=True)

    def _end(self, group: str, seed: int, told: str, failed: bool) -> None:
        self._ended += 1
        self.failed += failed
        state = self._state()
        if failed or not self._console.is_terminal:
            outcome = "failed: " if failed else ""
            self._say(f"{group}, seed {seed}: {outcome}{told}; {state}")
        self._bar.update(self._task, completed=self._ended, description=state)

    def _state(self) -> str:
        elapsed_s = wall_s() - self._began_wall_s
        left_s = elapsed_s * (self._planned - self._ended) / (self._ended - self._before)
        minutes, seconds = divmod(round(left_s), 60)
        failed = f", {self.failed} failed" if self.failed else ""
        return (
            f"{self._ended} of {self._planned} done{failed}, "
            f"{self._flown_sim_s / elapsed_s:.1f}x real time, ETA {minutes}:{seconds:02d}"
        )

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)
