"""Mission, rally-point and fence transfer, with each autopilot's codes and clocks, as recorded.

=====================  =============================================  ===========================================
event                  ArduPilot                                      PX4
=====================  =============================================  ===========================================
asks for an item with  MISSION_REQUEST                                MISSION_REQUEST_INT
asks again after       1.0 s                                          0.25 s
gives up after         8.0 s: MISSION_ACK 15 and a text               5.0 s: a text, no MISSION_ACK
items received count   at once: a broken upload leaves a mixture      only when all are there
station's MISSION_ACK  ignored                                        ends the upload
wrong sequence number  MISSION_ACK 13, goes on                        ignored, asked again
latitude 95            MISSION_ACK 10                                 stored
another station        MISSION_ACK 14                                 MISSION_ACK 1
too many               MISSION_ACK 4 and a text                       MISSION_ACK 4
item not asked for     MISSION_ACK 1                                  MISSION_ACK 1 and a text
=====================  =============================================  ===========================================

Item 0 of an ArduPilot mission is home, whatever was uploaded there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.mavlink.parameters import ParameterSet
from sitl_fixtures.mavlink.wire import Message
from sitl_fixtures.vehicle_protocol import VehicleProtocol

MISSION, FENCE, RALLY = 0, 1, 2
ACCEPTED, ERROR, UNSUPPORTED, NO_SPACE = 0, 1, 3, 4
INVALID_PARAM5_X, INVALID_PARAM6_Y, INVALID_SEQUENCE, DENIED, CANCELLED = 10, 11, 13, 14, 15

NAVIGATION = {16, 17, 18, 19, 20, 21, 22, 31, 82, 93, 94, 95}
ACTIONS = {112, 113, 114, 115, 177, 178, 179, 181, 182, 183, 184, 189, 190, 192, 195, 197, 201, 203, 205, 206, 207, 208}
ACTIONS |= {211, 212, 214, 216, 217, 218, 221, 223, 530, 531, 532, 1000, 1001, 2000, 2001, 2500, 2501, 3000, 42600}
FENCES = {5000, 5001, 5002, 5003, 5004}
RALLY_POINT = 5100
KNOWN_COMMANDS = {MISSION: NAVIGATION | ACTIONS, FENCE: FENCES, RALLY: {RALLY_POINT}}
# Commands whose place ArduPilot neither needs nor keeps.
PLACELESS = {20}
RELATIVE_FRAMES, TERRAIN_FRAMES = (3, 6), (10, 11)


@dataclass(frozen=True, slots=True)
class Item:
    """One item as stored: degrees times 1e7, metres in the frame's sense."""

    command: int
    frame: int
    params: tuple[float, float, float, float]
    x: int
    y: int
    z: float
    current: int = 0
    autocontinue: int = 1


@dataclass(slots=True)
class Upload:
    """A transfer under way, from one station."""

    link: int
    system_id: int
    component_id: int
    kind: int
    count: int
    received: list[Item]
    asked_s: float
    heard_s: float


@dataclass(frozen=True, slots=True)
class TransferRules:
    """What differs between the autopilots."""

    item_zero_is_home: bool
    at_once: bool
    ask_again_s: float
    give_up_s: float
    capacity: dict[int, int]


ARDUPILOT = TransferRules(True, True, 1.0, 8.0, {MISSION: 650, FENCE: 650, RALLY: 106})
PX4 = TransferRules(False, False, 0.255, 5.0, {MISSION: 2000, FENCE: 500, RALLY: 32})


class Missions:
    """The stored plans, the upload under way, and the message handlers."""

    def __init__(self, vehicle: VehicleProtocol, rules: TransferRules, parameters: ParameterSet) -> None:
        self._vehicle = vehicle
        self._parameters = parameters
        self.rules = rules
        self.plans: dict[int, list[Item]] = {MISSION: [], FENCE: [], RALLY: []}
        self.current = 0
        self._upload: Upload | None = None
        self._download: tuple[int, int] | None = None
        self.handlers: dict[str, Callable[[int, Message], None]] = {
            "MISSION_COUNT": self._on_count,
            "MISSION_ITEM_INT": self._on_item,
            "MISSION_ITEM": self._on_item,
            "MISSION_REQUEST_LIST": self._on_list,
            "MISSION_REQUEST_INT": self._on_request,
            "MISSION_REQUEST": self._on_request,
            "MISSION_ACK": self._on_ack,
            "MISSION_CLEAR_ALL": self._on_clear,
            "MISSION_SET_CURRENT": self._on_set_current,
        }

    @property
    def total(self) -> int:
        """How many items the mission has."""
        return len(self.plans[MISSION])

    @property
    def uploading(self) -> bool:
        """Whether a transfer to the vehicle is under way."""
        return self._upload is not None

    def current_message(self) -> Message:
        """MISSION_CURRENT."""
        return mavlink.MAVLink_mission_current_message(self.current, self.total, 0, 0)

    # -- sending ------------------------------------------------------------------------------------------------------

    def _ack(self, link: int, message: Message, result: int, kind: int) -> None:
        self._ack_to(link, message.get_srcSystem(), message.get_srcComponent(), result, kind)

    def _ack_to(self, link: int, system_id: int, component_id: int, result: int, kind: int) -> None:
        self._vehicle.send(mavlink.MAVLink_mission_ack_message(system_id, component_id, result, kind), link)

    def _ask(self, upload: Upload) -> None:
        make = (
            mavlink.MAVLink_mission_request_message
            if self.rules.at_once
            else mavlink.MAVLink_mission_request_int_message
        )
        self._vehicle.send(make(upload.system_id, upload.component_id, len(upload.received), upload.kind), upload.link)
        upload.asked_s = self._vehicle.time_s

    def _ours(self, message: Message) -> bool:
        return message.target_system in (0, self._vehicle.config.system_id) and message.target_component in (0, 1)

    # -- upload -------------------------------------------------------------------------------------------------------

    def _on_count(self, link: int, message: Message) -> None:
        if not self._ours(message):
            return
        kind, busy, now = message.mission_type, self._upload, self._vehicle.time_s
        if kind not in self.plans:
            self._ack(link, message, UNSUPPORTED, kind)
            return
        same = busy is not None and (busy.system_id, busy.component_id) == (
            message.get_srcSystem(),
            message.get_srcComponent(),
        )
        if busy is not None and not same:
            self._ack(link, message, DENIED if self.rules.at_once else ERROR, kind)
            return
        if message.count > self.rules.capacity[kind]:
            self._ack(link, message, NO_SPACE, kind)
            if self.rules.at_once:
                self._vehicle.autopilot.text(
                    f"Only {self.rules.capacity[kind]} items are supported", mavlink.MAV_SEVERITY_WARNING
                )
            return
        self._download = None
        if self.rules.at_once:
            del self.plans[kind][message.count :]
        if message.count == 0:
            self._upload = None
            self.plans[kind] = []
            self._changed(kind)
            self._ack(link, message, ACCEPTED, kind)
            return
        system_id, component_id = message.get_srcSystem(), message.get_srcComponent()
        self._upload = Upload(link, system_id, component_id, kind, message.count, [], now, now)
        self._ask(self._upload)

    def _on_item(self, link: int, message: Message) -> None:
        if not self._ours(message):
            return
        upload, px4 = self._upload, not self.rules.at_once
        if upload is None or upload.kind != message.mission_type:
            self._ack(link, message, ERROR, message.mission_type)
            if px4:
                self._vehicle.autopilot.text("IGN MISSION_ITEM: No transfer", mavlink.MAV_SEVERITY_CRITICAL)
            return
        if (upload.system_id, upload.component_id) != (message.get_srcSystem(), message.get_srcComponent()):
            return
        upload.heard_s = self._vehicle.time_s
        if message.seq != len(upload.received):
            if not px4:
                self._ack(link, message, INVALID_SEQUENCE, upload.kind)
            return
        item = _item_of(message, ardupilot=self.rules.at_once)
        refusal = self._refusal(upload.kind, item)
        if refusal is not None:
            self._upload = None
            self._ack(link, message, refusal, upload.kind)
            if px4:
                self._vehicle.after(
                    0.04,
                    lambda: self._vehicle.autopilot.text(
                        "IGN MISSION_ITEM: Invalid item", mavlink.MAV_SEVERITY_CRITICAL
                    ),
                )
            return
        upload.received.append(item)
        if self.rules.at_once:
            self._store_at_once(upload.kind, message.seq, item)
        if len(upload.received) < upload.count:
            self._ask(upload)
            return
        self._upload = None
        if not self.rules.at_once:
            self.plans[upload.kind] = upload.received
        self._ack(link, message, ACCEPTED, upload.kind)
        if self.rules.at_once and upload.kind == MISSION:
            self._vehicle.autopilot.text("Flight plan received", link=link)
        if upload.kind == MISSION:
            self.current = 0
        self._changed(upload.kind)

    def _refusal(self, kind: int, item: Item) -> int | None:
        if item.command not in KNOWN_COMMANDS[kind]:
            return UNSUPPORTED
        if self.rules.at_once:
            if abs(item.x) > 900_000_000:
                return INVALID_PARAM5_X
            if abs(item.y) > 1_800_000_000:
                return INVALID_PARAM6_Y
        return None

    def _store_at_once(self, kind: int, seq: int, item: Item) -> None:
        """ArduPilot: an item takes its place the moment it arrives, and the count grows with it."""
        plan = self.plans[kind]
        if seq < len(plan):
            plan[seq] = item
            return
        plan.append(item)
        self._changed(kind)

    def _changed(self, kind: int) -> None:
        name = {MISSION: "MIS_TOTAL", RALLY: "RALLY_TOTAL"}.get(kind)
        parameters = self._parameters
        if name is None or name not in parameters or parameters[name] == len(self.plans[kind]):
            return
        parameters.put(name, len(self.plans[kind]))
        self._vehicle.defer(lambda: self._vehicle.broadcast_parameter(name))

    def tick(self, now_s: float) -> None:
        """Asks again, and gives up in the end."""
        upload = self._upload
        if upload is None:
            return
        if now_s - upload.heard_s >= self.rules.give_up_s:
            self._upload = None
            if self.rules.at_once:
                self._ack_to(upload.link, upload.system_id, upload.component_id, CANCELLED, upload.kind)
                self._vehicle.autopilot.text("Mission upload timeout", mavlink.MAV_SEVERITY_WARNING, upload.link)
            else:
                self._vehicle.autopilot.text("Operation timeout", mavlink.MAV_SEVERITY_CRITICAL)
        elif now_s - upload.asked_s >= self.rules.ask_again_s:
            self._ask(upload)

    # -- download and the rest ----------------------------------------------------------------------------------------

    def _on_list(self, link: int, message: Message) -> None:
        if not self._ours(message) or message.mission_type not in self.plans:
            return
        if self._upload is not None:
            self._ack(link, message, DENIED if self.rules.at_once else ERROR, message.mission_type)
            return
        self._download = (link, message.mission_type)
        self._send_count(link, message)

    def _send_count(self, link: int, message: Message) -> None:
        system_id, component_id = message.get_srcSystem(), message.get_srcComponent()
        count = len(self._listed(message.mission_type))
        self._vehicle.send(
            mavlink.MAVLink_mission_count_message(system_id, component_id, count, message.mission_type), link
        )

    def _listed(self, kind: int) -> list[Item]:
        """The plan as it is given out: an ArduPilot mission starts with home."""
        plan = self.plans[kind]
        home = self._vehicle.autopilot.home
        if kind != MISSION or not self.rules.item_zero_is_home or home is None or not plan:
            return plan
        return [Item(16, 0, (0.0, 0.0, 0.0, 0.0), round(home[0] * 1e7), round(home[1] * 1e7), home[2]), *plan[1:]]

    def home_was_set(self) -> None:
        """ArduPilot keeps home as item 0: a mission that was empty has one item from then on."""
        if self.rules.item_zero_is_home and not self.plans[MISSION]:
            self.plans[MISSION] = [Item(16, 0, (0.0, 0.0, 0.0, 0.0), 0, 0, 0.0)]
            self._changed(MISSION)

    def _on_request(self, link: int, message: Message) -> None:
        if not self._ours(message) or message.mission_type not in self.plans:
            return
        plan = self._listed(message.mission_type)
        if not self.rules.at_once and (self._download is None or message.seq >= len(plan)):
            return
        if message.seq >= len(plan):
            # The size is told once more, so that the station learns of it.
            self._send_count(link, message)
            self._ack(link, message, INVALID_SEQUENCE, message.mission_type)
            return
        item = plan[message.seq]
        as_int = message.get_type() == "MISSION_REQUEST_INT"
        make = mavlink.MAVLink_mission_item_int_message if as_int else mavlink.MAVLink_mission_item_message
        self._vehicle.send(
            make(
                message.get_srcSystem(),
                message.get_srcComponent(),
                message.seq,
                item.frame,
                item.command,
                item.current if not self.rules.at_once else int(message.seq == self.current and message.seq > 0),
                item.autocontinue,
                *item.params,
                item.x if as_int else item.x / 1e7,
                item.y if as_int else item.y / 1e7,
                item.z,
                message.mission_type,
            ),
            link,
        )

    def _on_ack(self, link: int, message: Message) -> None:
        if not self._ours(message):
            return
        self._download = None
        if not self.rules.at_once and self._upload is not None and message.type == CANCELLED:
            self._upload = None

    def _on_clear(self, link: int, message: Message) -> None:
        if not self._ours(message):
            return
        kinds = list(self.plans) if message.mission_type == 255 else [message.mission_type]
        if self._upload is not None:
            self._ack(link, message, DENIED if self.rules.at_once else ERROR, message.mission_type)
            return
        for kind in kinds:
            if kind in self.plans:
                self.plans[kind] = []
                self._changed(kind)
        self.current = 0
        self._ack(link, message, ACCEPTED, message.mission_type)

    def _on_set_current(self, link: int, message: Message) -> None:
        if self._ours(message) and message.seq < self.total:
            self.current = message.seq
            self._vehicle.send(self.current_message())


def _item_of(message: Message, *, ardupilot: bool) -> Item:
    """What is kept of a MISSION_ITEM_INT (or the old MISSION_ITEM). ArduPilot keeps no place where none is needed."""
    is_int = message.get_type() == "MISSION_ITEM_INT"
    x = message.x if is_int else round(message.x * 1e7)
    y = message.y if is_int else round(message.y * 1e7)
    params = (message.param1, message.param2, message.param3, message.param4)
    if ardupilot and message.command in PLACELESS:
        return Item(message.command, 0, params, 0, 0, 0.0, message.current, message.autocontinue)
    # ArduPilot gives the plain frames back, PX4 those for integers.
    plain = {5: 0, 6: 3, 11: 10}
    changed = plain if ardupilot else {value: key for key, value in plain.items()}
    frame = changed.get(message.frame, message.frame)
    return Item(message.command, frame, params, x, y, message.z, message.current, message.autocontinue)
