"""What a telemetry log holds of a flight: the setpoints sent, the positions heard, as arrays."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.autopilot.registry import profile_of_setpoints
from link.files.link_report import ProbeCount
from link.files.tlog import TlogRecord
from planner.arrays import Array, Flags, Indices

SETPOINT_IDS = frozenset({84, 86})


def station_names(plan: Plan) -> dict[int, str]:
    """The plan's stations in flight order, by their system ids."""
    return {
        int(plan.mission.stations[i].system_id or 0): plan.mission.stations[i].id
        for i in dict.fromkeys(plan.trajectory.sequence)
    }


@dataclass(frozen=True)
class Sent:
    """Setpoints: arrays of one length; velocity (N, 3) east, north, up along true axes."""

    time_s: Array
    system_id: Indices
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array
    velocity_m_s: Array

    def only(self, keep: Flags) -> Sent:
        """Those of them to ``keep``."""
        return Sent(*(getattr(self, name)[keep] for name in self.__dataclass_fields__))


@dataclass(frozen=True)
class Heard:
    """Positions: when (log's clock, by the vehicle's), where."""

    time_s: Array
    lat_deg: Array
    lon_deg: Array
    alt_amsl_m: Array


def collect(
    records: Iterable[TlogRecord], plan: Plan, probes: ProbeCount
) -> tuple[Sent, Heard, AutopilotProfile, float]:
    """Setpoints, positions, the autopilot, and when the log ends (Unix time); probes are counted by ``probes``."""
    end_s = 0.0
    stations = set(station_names(plan))
    vehicle = plan.mission.options.vehicle_system_id
    origin: EkfOrigin | None = None
    kinds: dict[int, int] = {}
    local: list[tuple[float, ...]] = []
    sent: list[tuple[float, ...]] = []
    positions: dict[int, tuple[float, ...]] = {}
    for record in records:
        m = record.message
        if m is None:
            continue
        system, number = m.get_srcSystem(), m.get_msgId()
        end_s = max(end_s, record.time_utc_s)
        if number == 111:
            probes.note(record.time_utc_s, system, m, vehicle=system == vehicle and m.get_srcComponent() == 1)
        elif number in SETPOINT_IDS and system in stations:
            kinds[number] = kinds.get(number, 0) + 1
            # NED to east, north, up.
            velocity = (m.vy, m.vx, -m.vz)
            if number == 86:
                sent.append((record.time_utc_s, system, m.lat_int * 1e-7, m.lon_int * 1e-7, m.alt, *velocity))
            elif origin is not None:
                local.append((record.time_utc_s, system, m.x, m.y, origin.alt_amsl_m - m.z, *velocity))
        elif system == vehicle and m.get_srcComponent() == 1:
            if number == 33:
                row = (record.time_utc_s, m.time_boot_ms * 1e-3, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3)
                # The same message comes over every link; the first is the fastest.
                positions.setdefault(m.time_boot_ms, row)
            elif number == 49:
                origin = EkfOrigin.from_message(m)
    profile = profile_of_setpoints(kinds)
    if origin is not None:
        sent += [(*p[:2], *profile.lat_lon_deg(origin, p[2], p[3]), *p[4:]) for p in local]
    table = np.array(sorted(sent), dtype=float).reshape(-1, 8)
    heard = np.array(list(positions.values()), dtype=float).reshape(-1, 5)
    return (
        Sent(table[:, 0], table[:, 1].astype(np.int64), table[:, 2], table[:, 3], table[:, 4], table[:, 5:8]),
        Heard(_on_log_clock(heard[:, 0], heard[:, 1]), heard[:, 2], heard[:, 3], heard[:, 4]),
        profile,
        end_s,
    )


def _on_log_clock(came_s: Array, boot_s: Array, window_s: float = 20.0) -> Array:
    """The log's clock at each of the vehicle's stamps: late only by the smallest delay within a window."""
    if not len(came_s):
        return came_s
    offset = came_s - boot_s
    block = np.floor((came_s - came_s[0]) / window_s).astype(np.int64)
    least = np.full(int(block.max()) + 1, np.inf)
    np.minimum.at(least, block, offset)
    before = np.concatenate([[np.inf], least[:-1]])
    return np.asarray(boot_s + np.minimum(least, before)[block])
