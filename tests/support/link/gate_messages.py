"""A gate over three stations, and messages to send through it."""

from __future__ import annotations

from link.dialect import mavlink
from link.transport.gate import TransmitterGate
from link.wire.codec import StationCodec

STATIONS = {"a": 241, "b": 242, "c": 243}


def new_gate() -> TransmitterGate:
    return TransmitterGate({name: StationCodec(number).encode for name, number in STATIONS.items()})


def command() -> object:
    return mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)


def heartbeat() -> object:
    return mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)


def timesync() -> object:
    return mavlink.MAVLink_timesync_message(0, 1)
