"""What PX4's failsafe parameters ask for, value by value."""

from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from companion.kernel.messages import FlightMode


class Action(IntEnum):
    """In order of severity: the worst of several is taken."""

    NONE = 0
    WARN = 1
    POSITION = 2
    ALTITUDE = 3
    HOLD = 4
    RETURN = 5
    LAND = 6
    DESCEND = 7
    """Down without knowing where."""
    TERMINATE = 8


ACTION_MODES: Final[Mapping[Action, FlightMode]] = {
    Action.POSITION: FlightMode.POSITION,
    Action.ALTITUDE: FlightMode.ALTITUDE,
    Action.HOLD: FlightMode.HOLD,
    Action.RETURN: FlightMode.RTL,
    Action.LAND: FlightMode.LAND,
    Action.DESCEND: FlightMode.LAND,
}


class Reaction(NamedTuple):
    action: Action
    delayed: bool = True
    """Whether HOLD comes first, for COM_FAIL_ACT_T: time for the pilot to take over."""
    lasting: bool = False
    """Whether it goes on, although its cause is gone, until a mode is commanded."""


def on_offboard_loss(value: int, sticks: bool) -> Reaction:
    """COM_OBL_RC_ACT: position, altitude, manual, return, land, hold, terminate, disarm.

    The first three need sticks (altitude and manual are flown as position); without them it
    returns.
    """
    by_hand = Action.POSITION if sticks else Action.RETURN
    actions = (by_hand, by_hand, by_hand, Action.RETURN, Action.LAND, Action.HOLD)
    return Reaction(_chosen(actions, value), delayed=False)


def on_position_loss(value: int, by_hand: bool) -> Reaction:
    """COM_POSCTL_NAVL: altitude, descend; what is not flown by hand descends."""
    return Reaction(Action.ALTITUDE if by_hand and value == 0 else Action.DESCEND, delayed=False)


def without_position(action: Action) -> Action:
    """What is left of an action where the place is not known."""
    needs_place = (Action.POSITION, Action.HOLD, Action.RETURN, Action.LAND)
    return Action.DESCEND if action in needs_place else action


def on_link_loss(value: int) -> Reaction:
    """NAV_DLL_ACT and NAV_RCL_ACT: none, hold, return, land, -, terminate, disarm."""
    actions = (Action.NONE, Action.HOLD, Action.RETURN, Action.LAND, Action.NONE)
    return Reaction(_chosen(actions, value), lasting=True)


def on_breach(value: int) -> Reaction:
    """GF_ACTION: none, warning, hold, return, terminate, land; hold comes at once."""
    actions = (
        *(Action.NONE, Action.WARN, Action.HOLD, Action.RETURN),
        *(Action.TERMINATE, Action.LAND),
    )
    action = _chosen(actions, value)
    return Reaction(action, delayed=action is not Action.HOLD, lasting=True)


def on_low_battery(value: int, emergency: bool) -> Reaction:
    """COM_LOW_BAT_ACT: warning, return, land, return when critical and land in an emergency."""
    last = Action.LAND if emergency else Action.RETURN
    return Reaction(_chosen((Action.WARN, Action.RETURN, Action.LAND, last), value))


def _chosen(actions: tuple[Action, ...], value: int) -> Action:
    """Values beyond those listed switch the motors off."""
    return actions[value] if value < len(actions) else Action.TERMINATE
