"""How far a tool has come, on stderr; nothing where that is no terminal."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")


@contextmanager
def progress_bar(console: Console) -> Iterator[Progress]:
    columns = BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} {task.description}")
    with Progress(
        *columns, TimeElapsedColumn(), console=console, disable=not console.is_terminal
    ) as bar:
        yield bar


def watched(items: Sequence[T], what: str, console: Console | None = None) -> Iterator[T]:
    """The items one by one; what is done with each counts as its time."""
    with progress_bar(console or Console(stderr=True)) as bar:
        yield from bar.track(items, description=what)
