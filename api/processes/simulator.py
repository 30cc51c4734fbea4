"""A simulator of our own beside a command: started for a plan, one link for each of its stations."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from typing import TYPE_CHECKING

from api.processes.children import Child, ChildError, Children, python_module

if TYPE_CHECKING:
    from gcs.plan import Plan

_READY_S = 30.0
# The flight begins so far above the ground the simulated vehicle stands on, m; higher where the plan goes down further,
# which stays this clear of the ground.
_CLIMB_M = 40.0
_CLEAR_M = 5.0
# Headroom over the mission's own speed limit, so that the vehicle can catch up.
_FASTER = 1.4
_TILT_DEG = 45.0
# What a vehicle must be set to before anybody lets it fly beyond sight; simulators come as unsafe as the real ones.
_SAFE_PARAMETERS = {
    "ardupilot": ("FS_GCS_ENABLE=1", "FS_OPTIONS=20"),
    "px4": ("COM_OBL_RC_ACT=3", "NAV_DLL_ACT=2"),
}
_PRIORITY = 5


def free_udp_ports(count: int) -> list[int]:
    """Ports nobody listens on just now."""
    with contextlib.ExitStack() as stack:
        sockets = [stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(count)]
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]


def home_under(plan: Plan) -> str:
    """``LAT,LON,ALT`` of ground for the simulator to stand on, under the plan's start, and below all of the plan.

    The simulated ground is level: a plan that goes down far from its start must not meet it.
    """
    start_m = plan.trajectory.evaluate(0.0)
    lat_deg, lon_deg = plan.plane.to_geodetic(float(start_m[0]), float(start_m[1]))
    lowest_m = float(plan.trajectory.control_points_m[..., 2].min())
    ground_amsl_m = min(float(start_m[2]) - _CLIMB_M, lowest_m - _CLEAR_M) + plan.plane.alt_amsl_m
    return f"{float(lat_deg):.9f},{float(lon_deg):.9f},{ground_amsl_m:.3f}"


def start_simulator(children: Children, plan: Plan, *, autopilot: str, speedup: float) -> tuple[Child, dict[str, str]]:
    """A simulated vehicle under the plan's start, and the link URL of each station of the plan.

    Returns once it is ready. Raises `ChildError` when it does not get so.
    """
    stations = list(dict.fromkeys(plan.station_ids))
    ports = free_udp_ports(len(stations))
    arguments = [
        f"--autopilot={autopilot}",
        f"--home={home_under(plan)}",
        f"--speedup={speedup:g}",
        f"--system-id={plan.mission.options.vehicle_system_id}",
        f"--max-speed={_FASTER * plan.mission.limits.max_speed_m_s:g}",
        f"--tilt={_TILT_DEG:g}",
        *(f"--param={text}" for text in _SAFE_PARAMETERS[autopilot]),
        *(f"--listen=udpin:127.0.0.1:{port}" for port in ports),
    ]
    child = children.start("simulator", python_module("sitl_fixtures", *arguments))
    _raise_priority(child.process.pid)
    deadline = time.monotonic() + _READY_S
    while "ready" not in child.output():
        child.check()
        if time.monotonic() > deadline:
            raise ChildError("the simulator did not get ready", {"said": child.output()[-2000:]})
        time.sleep(0.02)
    return child, {station: f"udpout:127.0.0.1:{port}" for station, port in zip(stations, ports, strict=True)}


def _raise_priority(pid: int) -> None:
    """Sped up, a late simulator looks like a vehicle that does not follow: let it go first where that is permitted."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(_PRIORITY))
