"""COMMAND_LONG and COMMAND_INT as a dialogue: acknowledged, answered, and done once."""

from collections.abc import Callable
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import Ack, AutopilotPort
from sitl.mavlink import commands
from sitl.mavlink.channel import Channel
from sitl.mavlink.link_commands import LinkCommands
from sitl.mavlink.places import Earth
from sitl.mavlink.snapshot import Message, Snapshot

_MEMORY_S: Final = 5.0  # clients give up a command sooner


class _Done(NamedTuple):
    """A command that was accepted."""

    content: tuple[object, ...]
    time_s: float


_NOTHING: Final = _Done((), 0.0)


class CommandProtocol:
    """Serves one autopilot. A retry of what was accepted is accepted again, and not done again."""

    def __init__(self, autopilot: AutopilotPort, earth: Earth, link_commands: LinkCommands) -> None:
        self._autopilot = autopilot
        self._earth = earth
        self._link_commands = link_commands
        self._done: dict[tuple[int, int], _Done] = {}
        """The last of each sender."""

    def obey(
        self,
        channel: Channel,
        message: mavlink.MAVLink_message,
        now: Snapshot,
        send: Callable[[Message], None],
    ) -> bool:
        """Whether all streams are to begin anew, because the vehicle has rebooted."""
        command = message.command
        parameters = commands.parameters_of(message, self._earth.datum)
        if command == mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
            ack, rebooted = self._reboot(parameters)
            send(_ack(message, ack))
            return rebooted
        outcome = self._link_commands.execute(channel, command, parameters, now)
        if outcome is None:
            if command == mavlink.MAV_CMD_DO_SET_MODE:
                # PX4's receiver accepts at once; its commander's verdict follows as a second one.
                send(_ack(message, Ack.ACCEPTED))
            outcome = self._execute(message, parameters, now.time_s), ()
        ack, answers = outcome
        send(_ack(message, ack))
        for answer in answers:
            send(answer)
        return False

    def _execute(
        self, message: mavlink.MAVLink_message, parameters: commands.Parameters, time_s: float
    ) -> Ack:
        sender = message.get_srcSystem(), message.get_srcComponent()
        content = message.command, *map(repr, parameters)  # so that NaN equals NaN
        done = self._done.get(sender, _NOTHING)
        retried = getattr(message, "confirmation", 0) > 0 and done.content == content
        if retried and time_s - done.time_s < _MEMORY_S:
            return Ack.ACCEPTED
        ack = commands.execute(self._autopilot, message.command, parameters)
        if ack is Ack.ACCEPTED:
            self._done[sender] = _Done(content, time_s)
        else:
            self._done.pop(sender, None)
        return ack

    def _reboot(self, p: commands.Parameters) -> tuple[Ack, bool]:
        """The answer still comes from the old self."""
        nothing_to_do, reboot = 0, 1
        if p[0] != reboot:
            return (Ack.ACCEPTED if p[0] == nothing_to_do else Ack.DENIED), False
        self._done.clear()
        ack = self._autopilot.reboot()
        return ack, ack is Ack.ACCEPTED


def _ack(message: mavlink.MAVLink_message, ack: Ack) -> Message:
    sender = message.get_srcSystem(), message.get_srcComponent()
    return mavlink.MAVLink_command_ack_message(message.command, int(ack), 0, 0, *sender)
