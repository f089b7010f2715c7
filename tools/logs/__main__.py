"""Logs of any flight: ours (MCAP), ground stations' (.tlog), PX4's (.ulg).

python -m tools.logs info LOG
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from companion.kernel.errors import EXIT_FAILED, EXIT_FLOWN, CompanionError
from tools.logs.align import align
from tools.logs.export import IMAGES, export
from tools.logs.opening import find_log, open_log
from tools.logs.recover import RECOVERED_SUFFIX, recover


def info(args: argparse.Namespace) -> int:
    """What the log is, and each series with its count, first and last time, and rate."""
    log = open_log(args.log)
    print(f"{log.path}: {log.kind}")
    for name, fact in log.facts().items():
        print(f"  {name}: {fact}")
    print(f"{'records':>9}  {'from s':>12}  {'to s':>12}  {'Hz':>7}  series")
    for name, count in sorted(log.records().items()):
        if count and name not in IMAGES:
            time_s = log.table(name).time_s
            span_s = time_s[-1] - time_s[0]
            rate = f"{(count - 1) / span_s:7.1f}" if span_s > 0 else f"{'–':>7}"
            print(f"{count:9d}  {time_s[0]:12.3f}  {time_s[-1]:12.3f}  {rate}  {name}")
        else:
            print(f"{count:9d}  {'':12}  {'':12}  {'':7}  {name}")
    return EXIT_FLOWN


def verify(args: argparse.Namespace) -> int:
    """Checksums, order, gaps and counts; exit code 1 where the log is not sound."""
    log = open_log(args.log)
    health = log.examine()
    for finding in health.findings:
        print(f"{'PROBLEM' if finding.problem else 'note'}: {finding.text}")
    total = sum(health.records.values())
    print(f"{log.path}: {'sound' if health.sound else 'NOT SOUND'}, {total} records")
    return EXIT_FLOWN if health.sound else EXIT_FAILED


def export_series(args: argparse.Namespace) -> int:
    """One file per series."""
    log = open_log(args.log)
    offset_s = align(open_log(args.align_to), log).offset_s if args.align_to else 0.0
    out = args.out or log.path.with_suffix("")
    for path in export(log, out, args.format, args.series, offset_s):
        print(path)
    return EXIT_FLOWN


def recover_log(args: argparse.Namespace) -> int:
    """A whole MCAP file out of one that was cut off by a kill."""
    path = find_log(args.log)
    out = args.out or path.with_suffix(RECOVERED_SUFFIX)
    found = recover(path, out)
    lost = f"{found.lost_bytes} bytes unreadable" if found.lost_bytes else "nothing unreadable"
    damaged = f", {found.damaged_parts} damaged parts" if found.damaged_parts else ""
    orphans = f", {found.orphans} records of unknown topic dropped" if found.orphans else ""
    state = "was whole" if found.was_whole else "was cut off"
    print(f"{out}: {found.records} records; {path.name} {state}{damaged}, {lost}{orphans}")
    return EXIT_FLOWN


def align_logs(args: argparse.Namespace) -> int:
    """How far the clock of OTHER is behind that of LOG."""
    fit = align(open_log(args.log), open_log(args.other))
    if args.json:
        print(json.dumps(fit._asdict()))
    else:
        print(
            f"time in {args.log} = time in {args.other} {fit.offset_s:+.3f} s, "
            f"by {fit.signal}, correlation {fit.correlation:.3f}"
        )
    return EXIT_FLOWN


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tools.logs", description=__doc__)
    verbs = parser.add_subparsers(required=True)
    commands = {
        "info": info, "verify": verify, "export": export_series, "recover": recover_log,
        "align": align_logs,
    }  # fmt: skip
    chosen = {}
    for name, command in commands.items():
        chosen[name] = verbs.add_parser(name, help=command.__doc__, description=command.__doc__)
        chosen[name].add_argument("log", type=Path, metavar="LOG", help="log, or log folder")
        chosen[name].set_defaults(command=command)
    words = chosen["export"]
    words.add_argument("--out", type=Path, help="folder; default: the log's name without suffix")
    words.add_argument("--format", choices=("csv", "parquet"), default="csv")
    words.add_argument("--series", nargs="+", default=(), help="default: all but images")
    words.add_argument("--align-to", type=Path, help="write times on the clock of this log")
    chosen["recover"].add_argument("--out", type=Path, help="default: NAME.recovered.mcap")
    chosen["align"].add_argument("other", type=Path, metavar="OTHER")
    chosen["align"].add_argument("--json", action="store_true")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    args = _parser().parse_args(argv)
    try:
        return int(args.command(args))
    except CompanionError as error:
        print(f"logs: {error}", file=sys.stderr)
        return error.exit_code


if __name__ == "__main__":
    sys.exit(main())
