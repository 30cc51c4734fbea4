"""The faults of link, telemetry, commands, parameters and missions by name, and the whole table.

Each row says what goes wrong and when; ``actions.py`` says how, ``injection.py`` lets it act.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.faults import actions as do
from sitl_fixtures.faults.fault import Acting, Fault
from sitl_fixtures.faults.table_flight import FLIGHT_FAULTS

DENIED, REJECTED, FAILED, UNSUPPORTED = 2, 1, 4, 3
ACCEPTED = 0


def _flood(acting: Acting) -> None:
    acting.vehicle.autopilot.text("Vibration compensation ON")


def _revert(acting: Acting) -> None:
    acting.vehicle.parameters.restore()
    acting.vehicle.autopilot.refresh()


def _text_rubbish(acting: Acting) -> None:
    acting.vehicle.send(mavlink.MAVLink_statustext_message(2, b"\xff\xfe\x00\x80 not text", 0, 0))


def _gaps(acting: Acting, message: object) -> do.Pass:
    lost = getattr(message, "param_index", 65535) % 7 == 3 and message.get_type() == "PARAM_VALUE"  # type: ignore[attr-defined]
    return () if lost else do.kept(message)


def _wrong_value(acting: Acting, message: object) -> None:
    message.param_value = message.param_value + acting.value  # type: ignore[attr-defined]


def _count_off(acting: Acting, message: object) -> None:
    message.count = max(0, message.count + int(acting.value))  # type: ignore[attr-defined]


def _wrong_command(acting: Acting, message: object) -> None:
    message.command = message.command ^ 1  # type: ignore[attr-defined]


_MISSION_ASKS = ("MISSION_REQUEST", "MISSION_REQUEST_INT")

_ROWS = [
    # Telemetry and link
    Fault("telemetry-loss", "link", "nothing leaves the vehicle", start="T10", duration_s=5.0, outgoing=do.lose()),
    Fault("telemetry-loss-share", "link", "a share of messages is lost", "SHARE", 0.3, outgoing=do.lose_share()),
    Fault("telemetry-late", "link", "everything leaves late", "SECONDS", 0.5, outgoing=do.delay()),
    Fault("telemetry-repeated", "link", "everything leaves several times", "TIMES", 2.0, outgoing=do.repeat()),
    Fault("telemetry-reordered", "link", "every other message leaves after the next", outgoing=do.swap_pairs),
    Fault(
        "link-cut",
        "link",
        "nothing leaves or is heard on a link",
        "LINK",
        0.0,
        "T10",
        5.0,
        do.deaf_on_link,
        frames=do.cut_link,
    ),
    Fault(
        "link-deaf", "link", "nothing is heard on a link, telemetry goes on", "LINK", 0.0, "T10", 5.0, do.deaf_on_link
    ),
    Fault(
        "link-mute", "link", "nothing leaves on a link, the vehicle hears", "LINK", 0.0, "T10", 5.0, frames=do.cut_link
    ),
    Fault("uplink-loss", "link", "nothing is heard on any link", start="T10", duration_s=5.0, incoming=do.drop()),
    Fault("uplink-loss-share", "link", "a share of messages is not heard", "SHARE", 0.3, incoming=do.drop_share()),
    Fault("uplink-late", "link", "everything is heard late", "SECONDS", 0.3, incoming=do.hear_late()),
    Fault("frames-damaged", "link", "a share of frames has a wrong byte", "SHARE", 0.2, frames=do.damage),
    Fault("frames-short", "link", "a share of frames is cut short", "SHARE", 0.1, frames=do.cut_short),
    Fault("frames-littered", "link", "random bytes between frames", "SHARE", 0.3, frames=do.litter),
    Fault("sequence-jumps", "link", "sequence numbers jump", "SHARE", 0.1, frames=do.skip_sequence),
    Fault("unknown-messages", "link", "frames of an unknown message id beside", "SHARE", 0.5, frames=do.unknown_beside),
    # What the vehicle says of itself
    Fault("heartbeat-loss", "telemetry", "no HEARTBEAT", start="T10", duration_s=10.0, outgoing=do.lose("HEARTBEAT")),
    Fault(
        "heartbeat-stuck",
        "telemetry",
        "HEARTBEAT shows the mode of before",
        start="T10",
        outgoing=do.freeze("HEARTBEAT"),
    ),
    Fault("heartbeat-late", "telemetry", "HEARTBEAT is late", "SECONDS", 3.0, outgoing=do.delay("HEARTBEAT")),
    Fault(
        "heartbeat-critical",
        "telemetry",
        "HEARTBEAT says CRITICAL",
        start="T10",
        outgoing=do.alter(do.put(system_status=5), "HEARTBEAT"),
    ),
    Fault(
        "heartbeat-wrong-autopilot",
        "telemetry",
        "HEARTBEAT names another autopilot",
        outgoing=do.alter(do.put(autopilot=20), "HEARTBEAT"),
    ),
    Fault(
        "other-vehicle",
        "telemetry",
        "another vehicle (42) is heard on the same link",
        frames=do.impersonate(do.OTHER_VEHICLE_ID),
    ),
    Fault(
        "position-loss",
        "telemetry",
        "no position messages",
        start="T10",
        duration_s=10.0,
        outgoing=do.lose(*do.POSITIONS),
    ),
    Fault(
        "position-stuck", "telemetry", "position messages stand still", start="T10", outgoing=do.freeze(*do.POSITIONS)
    ),
    Fault(
        "position-nan",
        "telemetry",
        "LOCAL_POSITION_NED is NaN",
        start="T10",
        outgoing=do.alter(do.put(x=math.nan, y=math.nan, z=math.nan), "LOCAL_POSITION_NED"),
    ),
    Fault("position-late", "telemetry", "position messages are late", "SECONDS", 1.0, outgoing=do.delay(*do.POSITIONS)),
    Fault("echo-loss", "telemetry", "no POSITION_TARGET_LOCAL_NED", outgoing=do.lose(*do.ECHO)),
    Fault(
        "echo-stuck", "telemetry", "POSITION_TARGET_LOCAL_NED stands still", start="T10", outgoing=do.freeze(*do.ECHO)
    ),
    Fault(
        "clock-jump", "telemetry", "time since boot jumps", "SECONDS", 3600.0, "T10", outgoing=do.alter(do.shift_clock)
    ),
    Fault("clock-stuck", "telemetry", "time since boot stands still", start="T10", outgoing=do.alter(do.stop_clock)),
    Fault("text-flood", "telemetry", "50 texts a second", start="T10", duration_s=10.0, step=do.every(0.02, _flood)),
    Fault("text-rubbish", "telemetry", "texts that are not text", start="T10", step=do.every(1.0, _text_rubbish)),
    Fault("home-unknown", "telemetry", "no HOME_POSITION", outgoing=do.lose("HOME_POSITION")),
    Fault("origin-unknown", "telemetry", "no GPS_GLOBAL_ORIGIN", outgoing=do.lose("GPS_GLOBAL_ORIGIN")),
    Fault("version-unknown", "telemetry", "no AUTOPILOT_VERSION", outgoing=do.lose("AUTOPILOT_VERSION")),
    # Commands
    Fault("ack-lost", "commands", "no acknowledgement; the command is obeyed", outgoing=do.lose("COMMAND_ACK")),
    Fault(
        "ack-lost-first",
        "commands",
        "the first N acknowledgements are lost",
        "N",
        1.0,
        outgoing=do.lose_first("COMMAND_ACK"),
    ),
    Fault("ack-late", "commands", "acknowledgements are late", "SECONDS", 2.0, outgoing=do.delay("COMMAND_ACK")),
    Fault(
        "ack-repeated", "commands", "each acknowledgement comes N times", "N", 3.0, outgoing=do.repeat("COMMAND_ACK")
    ),
    Fault(
        "ack-foreign",
        "commands",
        "acknowledgements are addressed to station 77",
        outgoing=do.alter(do.put(target_system=77), "COMMAND_ACK"),
    ),
    Fault(
        "ack-wrong-command",
        "commands",
        "acknowledgements name another command",
        outgoing=do.alter(_wrong_command, "COMMAND_ACK"),
    ),
    Fault("ack-without-effect", "commands", "accepted, and nothing done", "COMMAND", 0.0, incoming=do.answer(ACCEPTED)),
    Fault("command-denied", "commands", "denied", "COMMAND", 0.0, incoming=do.answer(DENIED)),
    Fault("command-failed", "commands", "failed", "COMMAND", 0.0, incoming=do.answer(FAILED)),
    Fault("command-unsupported", "commands", "unsupported", "COMMAND", 0.0, incoming=do.answer(UNSUPPORTED)),
    Fault(
        "command-rejected-once",
        "commands",
        "temporarily rejected the first time",
        "COMMAND",
        0.0,
        incoming=do.answer(REJECTED, only_first=True),
    ),
    Fault("command-in-progress", "commands", "in progress first, done later", "SECONDS", 2.0, incoming=do.in_progress),
    Fault("command-lost", "commands", "commands are not heard", incoming=do.drop(*do.COMMANDS)),
    Fault(
        "command-lost-first",
        "commands",
        "the first N commands are not heard",
        "N",
        1.0,
        incoming=do.drop_first(*do.COMMANDS),
    ),
    Fault("command-late", "commands", "commands are heard late", "SECONDS", 1.0, incoming=do.hear_late(*do.COMMANDS)),
    Fault(
        "mode-without-effect",
        "commands",
        "mode changes accepted, not made",
        incoming=do.answer(ACCEPTED),
        default=176.0,
        argument="COMMAND",
    ),
    Fault("arm-refused", "commands", "an arming check fails", arming_text="Compass not calibrated"),
    Fault("takeoff-ignored", "commands", "takeoff accepted, not made", "COMMAND", 22.0, incoming=do.answer(ACCEPTED)),
    # Parameters
    Fault("param-set-ignored", "parameters", "PARAM_SET is met with silence", "NAME", "", incoming=do.ignore_parameter),
    Fault(
        "param-set-refused",
        "parameters",
        "PARAM_SET is answered with the old value",
        "NAME",
        "",
        incoming=do.answer_without_setting,
    ),
    Fault(
        "param-reply-lost",
        "parameters",
        "the first N PARAM_VALUEs are lost",
        "N",
        1.0,
        outgoing=do.lose_first("PARAM_VALUE"),
    ),
    Fault("param-reply-late", "parameters", "PARAM_VALUE is late", "SECONDS", 2.0, outgoing=do.delay("PARAM_VALUE")),
    Fault("param-silent", "parameters", "parameters are not answered", outgoing=do.lose("PARAM_VALUE")),
    Fault("param-list-gaps", "parameters", "one in seven of a listing is missing", outgoing=_gaps),
    Fault(
        "param-wrong-value",
        "parameters",
        "PARAM_VALUE is off",
        "BY",
        1.0,
        outgoing=do.alter(_wrong_value, "PARAM_VALUE"),
    ),
    Fault("param-revert", "parameters", "parameters go back to what they were at start", start="T10", begin=_revert),
    # Missions
    Fault(
        "mission-ack-lost",
        "missions",
        "the first N MISSION_ACKs are lost",
        "N",
        1.0,
        outgoing=do.lose_first("MISSION_ACK"),
    ),
    Fault(
        "mission-request-lost",
        "missions",
        "a share of requests is lost",
        "SHARE",
        0.3,
        outgoing=do.lose_share(*_MISSION_ASKS),
    ),
    Fault(
        "mission-request-repeated",
        "missions",
        "each item is asked for N times",
        "N",
        2.0,
        outgoing=do.repeat(*_MISSION_ASKS),
    ),
    Fault(
        "mission-item-lost",
        "missions",
        "a share of items is not heard",
        "SHARE",
        0.3,
        incoming=do.drop_share("MISSION_ITEM_INT"),
    ),
    Fault(
        "mission-refused",
        "missions",
        "every upload ends with NO_SPACE",
        outgoing=do.alter(do.put(type=4), "MISSION_ACK"),
    ),
    Fault(
        "mission-count-off",
        "missions",
        "MISSION_COUNT is off",
        "BY",
        1.0,
        outgoing=do.alter(_count_off, "MISSION_COUNT"),
    ),
    Fault(
        "mission-silent",
        "missions",
        "transfers are not answered",
        incoming=do.drop("MISSION_COUNT", "MISSION_REQUEST_LIST"),
    ),
]
FAULTS: dict[str, Fault] = {fault.name: fault for fault in (*_ROWS, *FLIGHT_FAULTS)}
