"""The resampled stream as files: CSV, JSON lines, telemetry log. Produced piece by piece, never as a whole.

CSV and JSON lines carry the plan's own plane: metres from its origin, north, east and down, velocities and
accelerations along its axes; ``yaw_deg`` is the true course. A telemetry log carries what would go on the wire: the
autopilot profile's message from the system id of the station in control, with that station's 1 Hz heartbeat.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Literal

import numpy as np

from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.files.tlog import record
from link.setpoints.sampler import SetpointSampler
from link.setpoints.setpoint import SetpointBlock
from link.wire.codec import StationCodec

Format = Literal["csv", "jsonl", "tlog"]
FORMATS: tuple[Format, ...] = ("csv", "jsonl", "tlog")
DEFAULT_LAUNCH = datetime(2000, 1, 1, tzinfo=UTC)
"""Time base of a log without a launch time."""
HEARTBEAT_S = 1.0

COLUMNS = (
    "time_s",
    "station",
    "north_m",
    "east_m",
    "down_m",
    "vn_m_s",
    "ve_m_s",
    "vd_m_s",
    "an_m_s2",
    "ae_m_s2",
    "ad_m_s2",
    "yaw_deg",
    "lat_deg",
    "lon_deg",
    "alt_amsl_m",
    "handover",
)
_DECIMALS = (6, None, 4, 4, 4, 5, 5, 5, 5, 5, 5, 9, 9, 9, 4, None)


def setpoint_file(
    plan: Plan,
    rate_hz: float,
    file_format: Format,
    *,
    autopilot: str = "px4",
    launch: datetime | None = None,
    origin: EkfOrigin | None = None,
) -> Iterator[bytes]:
    """The file in pieces of up to a few thousand samples, ready to write or to send.

    ``autopilot``, ``launch`` (UTC, for the time base) and ``origin`` concern the telemetry log alone. ``origin`` is
    the EKF origin local coordinates are for, by default the plan's origin; an ArduPilot log names it in a
    SET_GPS_GLOBAL_ORIGIN (48) at its start.

    Raises `ValueError` at once for an unknown format or autopilot, a rate out of range, a ``launch`` without time zone.
    """
    if file_format not in FORMATS:
        raise ValueError(f"format is {file_format!r}, allowed are {', '.join(FORMATS)}")
    if autopilot not in PROFILES:
        raise ValueError(f"autopilot is {autopilot!r}, allowed are {', '.join(PROFILES)}")
    stream = SetpointSampler(plan, rate_hz)
    if file_format == "csv":
        return _csv(stream)
    if file_format == "jsonl":
        return _jsonl(stream)
    base = launch if launch is not None else DEFAULT_LAUNCH
    if base.tzinfo is None:
        raise ValueError(f"launch is {base.isoformat()} without a time zone, give UTC as in 2026-11-22T09:00:00Z")
    return _tlog(stream, PROFILES[autopilot], base, origin)


def _columns(stream: SetpointSampler, block: SetpointBlock) -> list[list[object]]:
    """The contract's columns, unrounded."""
    p, v, a = block.position_enu_m, block.velocity_enu_m_s, block.acceleration_enu_m_s2
    numbers = [
        block.time_s,
        *(p[:, 1], p[:, 0], 0.0 - p[:, 2]),
        *(v[:, 1], v[:, 0], 0.0 - v[:, 2]),
        *(a[:, 1], a[:, 0], 0.0 - a[:, 2]),
        *(block.yaw_deg, block.lat_deg, block.lon_deg, block.alt_amsl_m),
    ]
    columns: list[list[object]] = [column.tolist() for column in numbers]
    columns.insert(1, [stream.station_of_leg(leg)[0] for leg in block.leg.tolist()])
    columns.append([index or None for index in block.handover.tolist()])
    return columns


def _csv(stream: SetpointSampler) -> Iterator[bytes]:
    # A station id holds neither comma nor quote (gcs.mission.model), so nothing needs quoting.
    yield (",".join(COLUMNS) + "\n").encode()
    row = ",".join("%s" if d is None else f"%.{d}f" for d in _DECIMALS) + "\n"
    for block in stream.blocks():
        columns = _columns(stream, block)
        for place, decimals in enumerate(_DECIMALS):
            if decimals is not None:
                # Adding zero turns the -0.0 that rounding leaves into 0.0.
                rounded = np.round(np.array(columns[place], dtype=float), decimals) + 0.0
                # And 359.9999999996 rounds to 360, which is 0.
                columns[place] = (rounded % 360.0 if COLUMNS[place] == "yaw_deg" else rounded).tolist()
        columns[-1] = ["" if index is None else index for index in columns[-1]]
        yield "".join([row % values for values in zip(*columns, strict=True)]).encode()


def _jsonl(stream: SetpointSampler) -> Iterator[bytes]:
    # A template is four times faster than json.dumps of a dictionary a line; repr is how JSON writes a finite float.
    row = (
        "{"
        + ", ".join(f'"{name}": %{"s" if d is None else "r"}' for name, d in zip(COLUMNS, _DECIMALS, strict=True))
        + "}\n"
    )
    for block in stream.blocks():
        columns = _columns(stream, block)
        columns[1] = [json.dumps(station) for station in columns[1]]
        columns[-1] = [json.dumps(index) for index in columns[-1]]
        yield "".join([row % values for values in zip(*columns, strict=True)]).encode()


def _tlog(
    stream: SetpointSampler, profile: AutopilotProfile, launch: datetime, origin: EkfOrigin | None
) -> Iterator[bytes]:
    plane = stream.plan.plane
    if origin is None:
        origin = EkfOrigin(plane.lat_deg, plane.lon_deg, plane.alt_amsl_m)
    vehicle = stream.plan.mission.options.vehicle_system_id
    base_us = round(launch.timestamp()) * 1_000_000 + launch.microsecond
    codecs: dict[int, StationCodec] = {}
    heartbeat = mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )
    next_heartbeat_s, leg_before = 0.0, -1
    pieces: list[bytes] = []
    for number, setpoint in enumerate(stream):
        time_us = base_us + round(setpoint.time_s * 1e6)
        codec = codecs.setdefault(setpoint.system_id, StationCodec(setpoint.system_id))
        if setpoint.time_s >= next_heartbeat_s or setpoint.leg != leg_before:
            # A new station says who it is before its first setpoint.
            pieces.append(record(codec.encode(heartbeat), time_us))
            next_heartbeat_s = math.floor(setpoint.time_s / HEARTBEAT_S + 1e-9) * HEARTBEAT_S + HEARTBEAT_S
            leg_before = setpoint.leg
        if number == 0 and profile.needs_origin:
            told = mavlink.MAVLink_set_gps_global_origin_message(
                vehicle, round(origin.lat_deg * 1e7), round(origin.lon_deg * 1e7), round(origin.alt_amsl_m * 1e3)
            )
            pieces.append(record(codec.encode(told), time_us))
        message = profile.encode(setpoint, target_system=vehicle, origin=origin)
        pieces.append(record(codec.encode(message), time_us))
        if len(pieces) >= 4096:
            yield b"".join(pieces)
            pieces.clear()
    yield b"".join(pieces)
