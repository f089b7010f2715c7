"""Our own flight log as series; its health chunk by chunk."""

from collections import Counter
from pathlib import Path

import msgspec
from mcap.records import Channel, Chunk, Message, Statistics

from companion.flightlog import FlightLog, Topic
from companion.plan import Plan
from tools.logs.scan import MCAP_MAGIC, Damage, End, scan
from tools.logs.series import (
    Finding,
    Health,
    Table,
    backward_steps,
    gaps,
    problem,
    remark,
    seconds,
)

__all__ = ["MCAP_MAGIC", "FlightReader"]

PER_FRAME = (Topic.PERCEPT, Topic.DECISION, Topic.SETPOINT)
"""One record each for every frame that was flown."""


class FlightReader:
    """The times of a series are those of the log, whichever clock stamped the records."""

    kind = "flight log (MCAP)"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.log = FlightLog(path)

    def facts(self) -> dict[str, str]:
        metadata = self.log.metadata
        plan = metadata.plan
        return {
            "room": str(plan.get("room", "")),
            "scheme": str(plan.get("experiment", {}).get("scheme", "")),
            "seed": str(metadata.seed),
            "companion": metadata.version,
        }

    def records(self) -> dict[str, int]:
        return self.log.topics()

    def table(self, series: str) -> Table:
        return Table(seconds(self.log.log_times_ns(series)), self.log.columns(series))

    def examine(self) -> Health:
        scanned = _Scanned(self.path)
        findings = scanned.findings()
        for topic in PER_FRAME:
            stamps_s = seconds(scanned.stamps_ns.get(topic, []))
            findings += backward_steps(f"{topic} (frame stamps)", stamps_s)
            findings += gaps(topic, stamps_s, self._longest_gap_s())
        for name, times_ns in sorted(scanned.times_ns.items()):
            findings += backward_steps(name, seconds(times_ns))
        findings += _uneven({topic: scanned.counts[topic] for topic in PER_FRAME})
        return Health(dict(scanned.counts), findings)

    def _longest_gap_s(self) -> float:
        """Without frames for so long the companion stops the vehicle: the plan says when."""
        try:
            return msgspec.convert(self.log.metadata.plan, Plan).safety.stop_after_s
        except msgspec.ValidationError:  # another version's plan
            return Plan().safety.stop_after_s


class _Scanned:
    """The whole file, read once."""

    def __init__(self, path: Path) -> None:
        self.counts: Counter[str] = Counter()
        self.times_ns: dict[str, list[int]] = {}
        self.stamps_ns: dict[str, list[int]] = {}
        self.chunks = 0
        self.damages: list[Damage] = []
        self.end = End(False, 0)
        self._statistics: Statistics | None = None
        self._topics: dict[int, str] = {}
        for part in scan(path):
            match part:
                case Message():
                    self._count(part)
                case Channel():
                    self._topics[part.id] = part.topic
                case Chunk():
                    self.chunks += 1
                case Statistics():
                    self._statistics = part
                case Damage():
                    self.damages.append(part)
                case End():
                    self.end = part

    def _count(self, message: Message) -> None:
        topic = self._topics.get(message.channel_id, f"channel {message.channel_id}")
        self.counts[topic] += 1
        self.times_ns.setdefault(topic, []).append(message.log_time)
        self.stamps_ns.setdefault(topic, []).append(message.publish_time)

    def findings(self) -> list[Finding]:
        found = [remark(f"{self.chunks} chunks with the right checksum")]
        found += [
            problem(f"damaged at byte {where.offset}, {where.length} bytes: {where.reason}")
            for where in self.damages
        ]
        if not self.end.whole:
            found.append(
                problem(f"cut off: no index at its end, {self.end.unread_bytes} bytes unread")
            )
        if self._statistics and self._statistics.message_count != self.counts.total():
            count = self._statistics.message_count
            found.append(problem(f"{self.counts.total()} records read, {count} written"))
        return found


def _uneven(counts: dict[Topic, int]) -> list[Finding]:
    if len(set(counts.values())) == 1:
        return []
    text = ", ".join(f"{topic} {count}" for topic, count in counts.items())
    # A log that was cut off may miss the last record of one topic, and then says so itself.
    one_frame = max(counts.values()) - min(counts.values()) <= 1
    return [(remark if one_frame else problem)(f"records per frame differ: {text}")]
