"""What faults do: small actions the rows of the table are put together from."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.faults.fault import Acting, Frames, Hook, Incoming, Outgoing, Step
from sitl_fixtures.mavlink.wire import Message, checksum

COMMANDS = ("COMMAND_LONG", "COMMAND_INT")
SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT")
POSITIONS = ("LOCAL_POSITION_NED", "GLOBAL_POSITION_INT")
ECHO = ("POSITION_TARGET_LOCAL_NED",)
OTHER_VEHICLE_ID = 42

Pass = tuple[tuple[Message, float], ...]


def kept(message: Message) -> Pass:
    """The message as it is."""
    return ((message, 0.0),)


# -- on the way out ---------------------------------------------------------------------------------------------------


def lose(*names: str) -> Outgoing:
    """Messages of some names never leave; with no names, none does."""

    def act(acting: Acting, message: Message) -> Pass:
        return () if not names or message.get_type() in names else kept(message)

    return act


def lose_share(*names: str) -> Outgoing:
    """A share (the argument) of messages never leaves."""

    def act(acting: Acting, message: Message) -> Pass:
        if names and message.get_type() not in names:
            return kept(message)
        return () if acting.chance(acting.value) else kept(message)

    return act


def lose_first(*names: str) -> Outgoing:
    """The first N (the argument) messages never leave."""

    def act(acting: Acting, message: Message) -> Pass:
        if message.get_type() not in names:
            return kept(message)
        seen = acting.memory["seen"] = acting.memory.get("seen", 0) + 1
        return () if seen <= acting.value else kept(message)

    return act


def delay(*names: str) -> Outgoing:
    """Messages leave later by the argument, s."""

    def act(acting: Acting, message: Message) -> Pass:
        return ((message, acting.value),) if not names or message.get_type() in names else kept(message)

    return act


def repeat(*names: str) -> Outgoing:
    """Messages leave N (the argument) times, 5 ms apart."""

    def act(acting: Acting, message: Message) -> Pass:
        if names and message.get_type() not in names:
            return kept(message)
        return tuple((message, 0.005 * i) for i in range(int(acting.value)))

    return act


def freeze(*names: str) -> Outgoing:
    """Messages keep the content they had when the fault began; their own time goes on."""

    def act(acting: Acting, message: Message) -> Pass:
        name = message.get_type()
        if name not in names:
            return kept(message)
        first = acting.memory.setdefault(name, copy.copy(message))
        still = copy.copy(first)
        if hasattr(message, "time_boot_ms"):
            still.time_boot_ms = message.time_boot_ms
        return kept(still)

    return act


def alter(change: Callable[[Acting, Message], None], *names: str) -> Outgoing:
    """Changes a copy of messages of some names; with no names, of all."""

    def act(acting: Acting, message: Message) -> Pass:
        if names and message.get_type() not in names:
            return kept(message)
        changed = copy.copy(message)
        change(acting, changed)
        return kept(changed)

    return act


def put(**fields: object) -> Callable[[Acting, Message], None]:
    """Sets fields of a message where it has them."""

    def change(acting: Acting, message: Message) -> None:
        for name, value in fields.items():
            if hasattr(message, name):
                setattr(message, name, value)

    return change


def shift_clock(acting: Acting, message: Message) -> None:
    """The vehicle's clock is off by the argument, s."""
    if hasattr(message, "time_boot_ms"):
        message.time_boot_ms = (message.time_boot_ms + int(acting.value * 1000.0)) & 0xFFFFFFFF


def stop_clock(acting: Acting, message: Message) -> None:
    """The vehicle's clock stands still."""
    if hasattr(message, "time_boot_ms"):
        message.time_boot_ms = acting.memory.setdefault("ms", message.time_boot_ms)


def swap_pairs(acting: Acting, message: Message) -> Pass:
    """Every other message leaves after the one behind it."""
    acting.memory["odd"] = not acting.memory.get("odd", False)
    return ((message, 0.3 if acting.memory["odd"] else 0.0),)


# -- frames -----------------------------------------------------------------------------------------------------------


def cut_link(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """Nothing leaves on a link (the argument)."""
    return () if link == int(acting.value) else (frame,)


def damage(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """A share of frames has a byte changed."""
    if not acting.chance(acting.value):
        return (frame,)
    place = acting.vehicle.random.randrange(len(frame))
    return (frame[:place] + bytes((frame[place] ^ (1 + acting.vehicle.random.randrange(255)),)) + frame[place + 1 :],)


def litter(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """Random bytes arrive before a share of the frames, in the same datagram and in one of their own."""
    if not acting.chance(acting.value):
        return (frame,)
    rubbish = acting.vehicle.random.randbytes(20)
    return (rubbish + frame, rubbish)


def cut_short(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """A share of frames ends too early."""
    return (frame[: len(frame) // 2],) if acting.chance(acting.value) else (frame,)


def skip_sequence(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """The sequence number jumps by 10 now and then, as if frames were lost."""
    if acting.chance(acting.value):
        port = acting.vehicle.ports[link]
        port.sequence = (port.sequence + 10) & 0xFF
    return (frame,)


def unknown_beside(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
    """A frame of a message id nobody knows goes beside a share of the frames."""
    unknown = b"\xfd\x04\x00\x00\x00\x01\x01\x00\x00\x7f\x01\x02\x03\x04\x00\x00"
    return (frame, unknown) if acting.chance(acting.value) else (frame,)


def impersonate(system_id: int, share: float = 1.0) -> Frames:
    """Frames of another vehicle go beside the real ones, at another place and in another mode."""

    def act(acting: Acting, link: int, frame: bytes) -> Iterable[bytes]:
        message_id = frame[7] | frame[8] << 8 | frame[9] << 16
        message = mavlink.mavlink_map.get(message_id)
        if message is None or message_id not in (0, 32, 33) or not acting.chance(share):
            return (frame,)
        other = bytearray(frame)
        other[5] = system_id
        crc = checksum(bytes(other[1:-2]), message.crc_extra)
        other[-2:] = bytes((crc & 0xFF, crc >> 8))
        return (frame, bytes(other))

    return act


# -- on the way in ----------------------------------------------------------------------------------------------------


def drop(*names: str) -> Incoming:
    """Messages of some names are not heard; with no names, none is."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        return () if not names or message.get_type() in names else (message,)

    return act


def drop_share(*names: str) -> Incoming:
    """A share (the argument) of messages is not heard."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        if names and message.get_type() not in names:
            return (message,)
        return () if acting.chance(acting.value) else (message,)

    return act


def drop_first(*names: str) -> Incoming:
    """The first N (the argument) messages are not heard."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        if message.get_type() not in names:
            return (message,)
        seen = acting.memory["seen"] = acting.memory.get("seen", 0) + 1
        return () if seen <= acting.value else (message,)

    return act


def deaf_on_link(acting: Acting, link: int, message: Message) -> Iterable[Message]:
    """Nothing is heard on a link (the argument)."""
    return () if link == int(acting.value) else (message,)


def hear_late(*names: str) -> Incoming:
    """Messages are heard later by the argument, s."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        if names and message.get_type() not in names:
            return (message,)
        acting.vehicle.after(acting.value, lambda: acting.vehicle.handle(link, message))
        return ()

    return act


def hear_first_only(*names: str) -> Incoming:
    """Only the first message of some names is ever heard; later ones are replaced by it."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        if message.get_type() not in names:
            return (message,)
        return (acting.memory.setdefault("first", message),)

    return act


def answer(result: int, *, only_first: bool = False) -> Incoming:
    """Commands (the argument: a number, 0 for all) are answered with a result and not carried out."""

    def act(acting: Acting, link: int, message: Message) -> Iterable[Message]:
        if message.get_type() not in COMMANDS or acting.value not in (0.0, float(message.command)):
            return (message,)
        vehicle = acting.vehicle
        if not vehicle.autopilot.addressed(message) or not vehicle.autopilot.heard_from(link, message):
            return (message,)
        if only_first:
            seen = acting.memory["seen"] = acting.memory.get("seen", 0) + 1
            if seen > 1:
                return (message,)
        vehicle.send(
            mavlink.MAVLink_command_ack_message(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            ),
            link,
        )
        return ()

    return act


def in_progress(acting: Acting, link: int, message: Message) -> Iterable[Message]:
    """Commands are answered IN_PROGRESS and carried out after the argument, s."""
    vehicle = acting.vehicle
    if message.get_type() not in COMMANDS or not vehicle.autopilot.addressed(message):
        return (message,)
    ack = mavlink.MAVLink_command_ack_message(
        message.command, mavlink.MAV_RESULT_IN_PROGRESS, 50, 0, message.get_srcSystem(), message.get_srcComponent()
    )
    vehicle.send(ack, link)
    vehicle.after(acting.value, lambda: vehicle.handle(link, message))
    return ()


def ignore_parameter(acting: Acting, link: int, message: Message) -> Iterable[Message]:
    """PARAM_SET (the argument: a name, empty for all) is met with silence and changes nothing."""
    if message.get_type() == "PARAM_SET" and acting.text in ("", message.param_id):
        return ()
    return (message,)


def answer_without_setting(acting: Acting, link: int, message: Message) -> Iterable[Message]:
    """PARAM_SET is answered with the old value."""
    if message.get_type() != "PARAM_SET" or acting.text not in ("", message.param_id):
        return (message,)
    vehicle = acting.vehicle
    parameter = vehicle.parameters.find(message.param_id, -1)
    if parameter is not None and vehicle.autopilot.heard_from(link, message):
        vehicle.send_parameter(parameter, link, vehicle.autopilot.named_index(parameter))
    return ()


# -- moments and steps ------------------------------------------------------------------------------------------------


def set_body(**values: float) -> tuple[Hook, Hook]:
    """Sets attributes of the aircraft while the fault acts."""

    def begin(acting: Acting) -> None:
        for name, value in values.items():
            acting.memory[name] = getattr(acting.vehicle.body, name)
            setattr(acting.vehicle.body, name, value)

    def end(acting: Acting) -> None:
        for name in values:
            setattr(acting.vehicle.body, name, acting.memory[name])

    return begin, end


def slow_vehicle(acting: Acting) -> None:
    """30 degrees of lean and the drag that tops out at the argument, m/s."""
    body = acting.vehicle.body
    body.tilt_rad = math.radians(30.0)
    body.cap_speed(acting.value)


def force_mode(kind: str) -> Hook:
    """The vehicle changes its mode by itself."""

    def begin(acting: Acting) -> None:
        acting.vehicle.autopilot.force_mode(kind)

    return begin


def every(interval_s: float, action: Callable[[Acting], None]) -> Step:
    """Does something at an interval of vehicle time."""

    def step(acting: Acting, dt: float) -> None:
        if acting.vehicle.time_s >= acting.memory.get("next", 0.0):
            acting.memory["next"] = acting.vehicle.time_s + interval_s
            action(acting)

    return step
