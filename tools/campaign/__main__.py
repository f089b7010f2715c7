"""Flies a campaign and prints its table; the same command again goes on where it ended.

python -m tools.campaign flightplans/campaigns/schemes.toml
python -m tools.campaign CAMPAIGN.toml --scheduler tcp://host:8786
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError
from tools.arguments import count
from tools.campaign.plan import Campaign, load_campaign
from tools.campaign.progress import CampaignProgress
from tools.campaign.results import ResultsBook
from tools.campaign.run import open_client, run
from tools.campaign.stats import Table, tabulate
from tools.campaign.table import print_table, write_table

LEAST_COLUMNS = 100
"""That the tables get, however narrow the terminal."""


def fly_campaign(
    campaign: Campaign, folder: Path, scheduler: str | None, workers: int, console: Console
) -> tuple[Table, int]:
    """Flies what is missing; returns the table, and how many flights failed or were lost.

    Raises CompanionError.
    """
    with ResultsBook(folder) as book:
        missing = book.missing(campaign.flights)
        planned = len(campaign.flights)
        with CampaignProgress(console, planned, planned - len(missing)) as progress:
            if missing:
                with open_client(scheduler, min(workers, len(missing))) as client:
                    run(client, missing, book, progress)
        rows = [book.rows[flight.id] for flight in campaign.flights if flight.id in book.rows]
        table = tabulate(rows, campaign.groups)
        write_table(folder, table)
    failed = sum(row.outcome != "flown" for row in rows)
    return table, failed + planned - len(rows)


def main(argv: Sequence[str] | None = None) -> int:
    """Exit code 0: all flown, 1: a flight failed or the campaign was stopped, 2: usage."""
    options = _parser().parse_args(argv)
    folder = options.out or Path("logs") / f"campaign-{options.campaign.stem}"
    try:
        campaign = load_campaign(options.campaign, options.runs)
        table, failed = fly_campaign(
            campaign, folder, options.scheduler, options.workers, Console(stderr=True)
        )
    except CompanionError as error:
        print(f"campaign: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("campaign: stopped; the same command goes on from here", file=sys.stderr)
        return EXIT_FAILED
    console = Console()
    print_table(Console(width=max(console.width, LEAST_COLUMNS)), table)
    print(f"{len(campaign.flights)} flights, {failed} failed; rows, logs and tables: {folder}")
    return EXIT_FAILED if failed else EXIT_FLOWN


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tools.campaign",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("campaign", type=Path, help="campaign file (TOML)")
    parser.add_argument("--runs", type=count, help="flights of each kind, not the file's")
    cluster = parser.add_mutually_exclusive_group()
    cluster.add_argument(
        "--workers",
        type=count,
        default=len(os.sched_getaffinity(0)),
        help="processes on this machine; default: one per core",
    )
    cluster.add_argument("--scheduler", metavar="ADDRESS", help="Dask, e.g. tcp://host:8786")
    parser.add_argument("--out", type=Path, help="default: logs/campaign-NAME")
    return parser


if __name__ == "__main__":
    sys.exit(main())
