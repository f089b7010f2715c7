"""What is said when the cameras' health changes: short first, a STATUSTEXT holds 50 characters."""

from typing import NamedTuple

from companion.kernel.messages import Availability, CameraFault, Event


class State(NamedTuple):
    """The faults confirmed, by where they are."""

    left: CameraFault | None = None
    right: CameraFault | None = None
    pair: CameraFault | None = None
    timing: CameraFault | None = None


PLACES = State._fields
NAMES = {"left": "left eye", "right": "right eye", "pair": "pair", "timing": "camera"}


def events_of(
    stamp_ns: int,
    state: State,
    was: State,
    evidence: dict[str, str],
    available: Availability,
    alone_allowed: bool,
) -> tuple[Event, ...]:
    """One for each fault that came or went. ``alone_allowed``: one eye may fly where it must."""
    then = _consequence(available, alone_allowed)
    events = []
    for place, now, before in zip(PLACES, state, was, strict=True):
        if now is not None and now is not before:
            text = f"{NAMES[place]}: {now.value}; {then} ({evidence[place]})"
            events.append(_event(stamp_ns, "warning", text))
        elif now is None and before is not None:
            events.append(_event(stamp_ns, "info", f"{NAMES[place]}: well again"))
    return tuple(events)


def faults_in_words(state: State) -> str:
    present = zip(PLACES, state, strict=True)
    return ", ".join(f"{NAMES[place]}: {fault.value}" for place, fault in present if fault)


def return_of_stereo(stamp_ns: int, difference_px: float) -> Event:
    text = f"flying on stereo again ({difference_px:.1f} px from one eye's estimate)"
    return _event(stamp_ns, "info", text)


def _consequence(available: Availability, alone_allowed: bool) -> str:
    if available.stereo:
        return "flying on"
    if alone_allowed and available.left != available.right:
        return f"flying on the {'left' if available.left else 'right'} eye"
    return "flying on one eye" if alone_allowed and available.left else "stopping"


def _event(stamp_ns: int, severity: str, text: str) -> Event:
    return Event(stamp_ns=stamp_ns, severity=severity, text=text)
