"""Hands flights to a Dask cluster, and keeps what comes back."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from distributed import Client, LocalCluster, as_completed

from companion import __version__
from companion.kernel.errors import CompanionError
from tools.campaign.fly import fly_one, version
from tools.campaign.plan import PlannedFlight
from tools.campaign.results import ResultsBook
from tools.campaign.rows import Row, one_line

CONNECT_LIMIT_S = 10

logger = logging.getLogger(__name__)


class Watcher(Protocol):
    """Who is told how the campaign goes."""

    def landed(self, row: Row) -> None: ...

    def lost(self, flight: PlannedFlight, why: str) -> None:
        """No row: the next run will fly it again."""


def run(
    client: Client, flights: Sequence[PlannedFlight], book: ResultsBook, watcher: Watcher
) -> None:
    """Flies all of them; rows and logs go into the book as flights end.

    A worker that dies takes no flight with it: Dask gives its flights to another.
    """
    waiting = {
        client.submit(fly_one, flight, key=flight.id, pure=False): flight for flight in flights
    }
    for future in as_completed(list(waiting)):
        flight = waiting.pop(future)
        error = future.exception()
        if error is not None:
            watcher.lost(flight, one_line(f"{type(error).__name__}: {error}"))
            continue
        landed = future.result()
        book.add(landed)
        watcher.landed(landed.row)


@contextmanager
def open_client(scheduler: str | None, workers: int) -> Iterator[Client]:
    """A client of the scheduler at this address, or of as many workers of its own.

    Raises CompanionError when there is no scheduler, or not this package beside it.
    """
    logging.getLogger("distributed").setLevel(logging.ERROR)
    if scheduler is None:
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                memory_limit=None,
                dashboard_address="127.0.0.1:0",
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(scheduler, timeout=CONNECT_LIMIT_S)
    except (OSError, ValueError) as error:
        raise CompanionError(
            f"--scheduler {scheduler}: no Dask scheduler: {one_line(str(error))}"
        ) from error
    with client:
        _check_versions(client, scheduler)
        if not client.scheduler_info()["workers"]:
            logger.warning("no worker yet; start one anywhere: dask worker %s", scheduler)
        yield client


def _check_versions(client: Client, scheduler: str) -> None:
    """Flights travel as calls of this package; every process of the cluster must have it."""
    try:
        answers = {scheduler: client.run_on_scheduler(version)}
    except ImportError as error:
        answers = {scheduler: error}
    answers |= client.run(version, on_error="return")
    for address, answer in answers.items():
        if answer != __version__:
            found = f"no companion {__version__} with its tools there"
            raise CompanionError(f"--scheduler {scheduler}: {address}: {found}: {answer}")
