"""The mission protocol: uploads and downloads of missions, fences and rally points."""

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from pymavlink.dialects.v20 import common as mavlink

from sitl.autopilot.interface import AutopilotPort, Severity
from sitl.autopilot.mission import MissionItem
from sitl.mavlink.mission_items import (
    GLOBAL_SCALE,
    LOCAL_SCALE,
    Item,
    RejectedItemError,
    fence_areas,
    mission_item,
    rally_places,
)
from sitl.mavlink.places import Earth
from sitl.mavlink.snapshot import Message

Reply = Callable[[Message], None]
"""Sends to where a message came from."""

MAX_ITEMS: Final = 2000
"""Of one kind; PX4 has room for as many on an SD card."""
RETRY_S: Final = 0.25
"""Simulated time after which an item is asked for again (PX4's)."""
GIVE_UP_S: Final = 5.0
"""Simulated time without an item that ends an upload (PX4's)."""
LOOK_PERIOD_S: Final = 0.02
"""Simulated time between two looks at what has changed."""

_MISSION: Final = mavlink.MAV_MISSION_TYPE_MISSION
_FENCE: Final = mavlink.MAV_MISSION_TYPE_FENCE
_RALLY: Final = mavlink.MAV_MISSION_TYPE_RALLY
_ACCEPTED: Final = mavlink.MAV_MISSION_ACCEPTED


class _Client(NamedTuple):
    """Who asks, and about what."""

    system: int
    component: int
    kind: int

    @classmethod
    def of(cls, message: Message) -> "_Client":
        return cls(message.get_srcSystem(), message.get_srcComponent(), message.mission_type)

    def ack(self, result: int) -> Message:
        return mavlink.MAVLink_mission_ack_message(
            self.system, self.component, result, mission_type=self.kind
        )


class _Upload:
    """Items that arrive one by one, each asked for."""

    def __init__(self, client: _Client, count: int, reply: Reply, time_s: float) -> None:
        self.client = client
        self.count = count
        self.reply = reply
        self.items: list[Item] = []
        self.parsed: list[MissionItem] = []
        self.heard_s = time_s
        self.ask(time_s)

    def ask(self, time_s: float) -> None:
        """For the next item."""
        self.asked_s = time_s
        self.reply(
            mavlink.MAVLink_mission_request_int_message(
                self.client.system,
                self.client.component,
                len(self.items),
                mission_type=self.client.kind,
            )
        )


class MissionProtocol:
    """One upload at a time; what was there before is kept until a new plan is whole and sound."""

    def __init__(self, autopilot: AutopilotPort, earth: Earth) -> None:
        self._autopilot = autopilot
        self._earth = earth
        self._upload: _Upload | None = None
        self._last: tuple[_Client, int] | None = None
        """The client and last item of the upload that was accepted last."""
        self._stored: dict[int, list[Item]] = {_MISSION: [], _FENCE: [], _RALLY: []}
        self._told = autopilot.status.mission
        self._due_s = 0.0
        self.handlers: Mapping[int, Callable[[Message, Reply], None]] = {
            mavlink.MAVLINK_MSG_ID_MISSION_COUNT: self._on_count,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM_INT: self._on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_ITEM: self._on_item,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: self._on_request_list,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT: self._on_request,
            mavlink.MAVLINK_MSG_ID_MISSION_REQUEST: self._on_request,
            mavlink.MAVLINK_MSG_ID_MISSION_ACK: self._on_ack,
            mavlink.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: self._on_clear,
            mavlink.MAVLINK_MSG_ID_MISSION_SET_CURRENT: self._on_set_current,
            mavlink.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: self._on_partial,
        }

    def update(self) -> list[Message]:
        """Asks again where an answer is late; returns what all links are to be told.

        May be called at every step of the world: it looks fifty times a second.
        """
        upload, time_s = self._upload, self._time_s()
        if time_s < self._due_s:
            return []
        self._due_s = time_s + LOOK_PERIOD_S
        if upload is not None:
            if time_s - upload.heard_s >= GIVE_UP_S:
                self._end_upload(mavlink.MAV_MISSION_OPERATION_CANCELLED, "Upload timed out")
            elif time_s - upload.asked_s >= RETRY_S:
                upload.ask(time_s)
        return self._news()

    def _news(self) -> list[Message]:
        reached = self._autopilot.plans.mission.reached
        news = [mavlink.MAVLink_mission_item_reached_message(number) for number in reached]
        reached.clear()
        progress = self._autopilot.status.mission
        if progress != self._told:
            self._told = progress
            news.append(mavlink.MAVLink_mission_current_message(*progress))
        return news

    def _time_s(self) -> float:
        return self._autopilot.estimate.time_s

    # -- upload --------------------------------------------------------------------------------

    def _on_count(self, message: Message, reply: Reply) -> None:
        client, upload = _Client.of(message), self._upload
        if upload is not None and upload.client[:2] != client[:2]:
            reply(client.ack(mavlink.MAV_MISSION_DENIED))  # busy with another client
        elif client.kind not in self._stored:
            reply(client.ack(mavlink.MAV_MISSION_UNSUPPORTED))
        elif message.count > MAX_ITEMS:
            reply(client.ack(mavlink.MAV_MISSION_NO_SPACE))
        elif message.count == 0:
            self._upload = None
            self._clear(client.kind)
            reply(client.ack(_ACCEPTED))
        else:
            self._last = None
            self._upload = _Upload(client, message.count, reply, self._time_s())

    def _on_item(self, message: Message, reply: Reply) -> None:
        client, upload = _Client.of(message), self._upload
        if upload is None:
            if self._last == (client, message.seq):  # our acknowledgement was lost
                reply(client.ack(_ACCEPTED))
            return
        if client != upload.client or message.seq != len(upload.items):
            return  # a duplicate, or ahead of its turn: it will be asked for
        upload.heard_s = self._time_s()
        try:
            self._keep(upload, Item.of(message, self._earth.datum))
        except RejectedItemError as rejection:
            self._end_upload(rejection.result, str(rejection))

    def _keep(self, upload: _Upload, item: Item) -> None:
        upload.items.append(item)
        if upload.client.kind == _MISSION:
            upload.parsed.append(mission_item(item))
        if len(upload.items) < upload.count:
            upload.ask(self._time_s())
            return
        self._store(upload)
        self._last = (upload.client, item.number)
        upload.reply(upload.client.ack(_ACCEPTED))
        self._upload = None

    def _store(self, upload: _Upload) -> None:
        """Raises RejectedItemError, with nothing changed, for a plan that cannot be flown."""
        plans, items = self._autopilot.plans, upload.items
        if upload.client.kind == _MISSION:
            problem = plans.problem(upload.parsed)
            if problem is not None:
                raise RejectedItemError(problem.item, mavlink.MAV_MISSION_INVALID, problem.text)
            plans.mission.load(upload.parsed)
        elif upload.client.kind == _FENCE:
            plans.fence = fence_areas(items)
        else:
            plans.rally_ned_m = rally_places(items)
        self._stored[upload.client.kind] = items

    def _end_upload(self, result: int, text: str) -> None:
        """Without success."""
        if self._upload is not None:
            self._autopilot.announce(Severity.CRITICAL, text)
            self._upload.reply(self._upload.client.ack(result))
            self._upload = None

    def _on_ack(self, message: Message, reply: Reply) -> None:
        """Ends a download; the client that uploads may also give up with one."""
        del reply
        if self._upload is not None and _Client.of(message) == self._upload.client:
            self._upload = None

    # -- download ------------------------------------------------------------------------------

    def _on_request_list(self, message: Message, reply: Reply) -> None:
        client = _Client.of(message)
        if client.kind not in self._stored:
            reply(client.ack(mavlink.MAV_MISSION_UNSUPPORTED))
            return
        count = len(self._stored[client.kind])
        reply(
            mavlink.MAVLink_mission_count_message(
                client.system, client.component, count, mission_type=client.kind
            )
        )

    def _on_request(self, message: Message, reply: Reply) -> None:
        """Any item at any time: so a client may ask again for what was lost."""
        client = _Client.of(message)
        items = self._stored.get(client.kind, [])
        if message.seq >= len(items):
            reply(client.ack(mavlink.MAV_MISSION_INVALID_SEQUENCE))
            return
        item = items[message.seq]
        current = client.kind == _MISSION and item.number == self._autopilot.status.mission.current
        kind = mavlink.MAVLink_mission_item_int_message
        x: float = item.x
        y: float = item.y
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_MISSION_REQUEST:
            kind = mavlink.MAVLink_mission_item_message
            scale = LOCAL_SCALE if item.frame == mavlink.MAV_FRAME_LOCAL_NED else GLOBAL_SCALE
            x, y = x / scale, y / scale
        reply(
            kind(
                *(client.system, client.component, item.number, item.frame, item.command),
                *(int(current), item.autocontinue),
                *(item.param1, item.param2, item.param3, item.param4, x, y, item.z),
                mission_type=client.kind,
            )
        )

    # -- the rest ------------------------------------------------------------------------------

    def _on_clear(self, message: Message, reply: Reply) -> None:
        client = _Client.of(message)
        everything = client.kind == mavlink.MAV_MISSION_TYPE_ALL
        if not everything and client.kind not in self._stored:
            reply(client.ack(mavlink.MAV_MISSION_UNSUPPORTED))
            return
        self._upload = None
        for kind in list(self._stored) if everything else [client.kind]:
            self._clear(kind)
        reply(client.ack(_ACCEPTED))

    def _clear(self, kind: int) -> None:
        plans = self._autopilot.plans
        self._stored[kind] = []
        if kind == _MISSION:
            plans.mission.load(())
        elif kind == _FENCE:
            plans.fence = ()
        else:
            plans.rally_ned_m = ()

    def _on_set_current(self, message: Message, reply: Reply) -> None:
        """Answered with MISSION_CURRENT, whether it changed or not."""
        if not self._autopilot.plans.mission.select(message.seq):
            self._autopilot.announce(Severity.WARNING, f"No mission item {message.seq}")
        reply(mavlink.MAVLink_mission_current_message(*self._autopilot.status.mission))

    def _on_partial(self, message: Message, reply: Reply) -> None:
        reply(_Client.of(message).ack(mavlink.MAV_MISSION_UNSUPPORTED))
