"""An independent client flies the simulated autopilot: MAVSDK, over real UDP."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import pytest

from tests.support.flights.processes import free_ports

mavsdk = pytest.importorskip("mavsdk")

SPEEDUP = 4.0


def wait(condition: Callable[[], Any], limit_s: float = 40.0) -> None:
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, f"not within {limit_s} s"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("autopilot", "parameter", "value"), [("px4", "MPC_XY_VEL_MAX", 15.0), ("ardupilot", "WPNAV_SPEED", 1500.0)]
)
def test_mavsdk_reads_sets_uploads_arms_takes_off_and_lands(autopilot: str, parameter: str, value: float) -> None:
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.mission_raw import MissionRaw
    from mavsdk.plugins.mission_raw.mission_raw import MissionItem
    from mavsdk.plugins.param import Param
    from mavsdk.plugins.telemetry import Telemetry

    port = free_ports(1)[0]
    process = subprocess.Popen(
        [
            *[sys.executable, "-m", "sitl_fixtures", "--autopilot", autopilot, "--speedup", str(SPEEDUP)],
            *[f"--listen=udpout:127.0.0.1:{port}", "--home", "53.1,5.2,3.0"],
        ],
        stdout=subprocess.DEVNULL,
    )
    client = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    try:
        client.add_any_connection(f"udpin://127.0.0.1:{port}")
        system = client.first_autopilot(20.0)
        assert system is not None
        telemetry, action, param, mission = Telemetry(system), Action(system), Param(system), MissionRaw(system)

        assert param.get_param_float(parameter) != value
        param.set_param_float(parameter, value)
        assert param.get_param_float(parameter) == value

        wait(lambda: telemetry.health().is_armable)
        place = telemetry.position()
        assert (place.latitude_deg, place.longitude_deg) == pytest.approx((53.1, 5.2), abs=1e-6)
        assert place.absolute_altitude_m == pytest.approx(3.0, abs=0.1)

        items = [
            MissionItem(
                seq=seq,
                frame=6,
                command=command,
                current=int(seq == 0),
                autocontinue=1,
                param1=0.0,
                param2=0.0,
                param3=0.0,
                param4=float("nan"),
                x=531_000_000 + 10_000 * seq,
                y=52_000_000,
                z=20.0,
                mission_type=0,
            )
            for seq, command in enumerate([16, 16, 16, 16])
        ]
        mission.upload_mission(items)
        back = mission.download_mission()
        # ArduPilot keeps home as the first item.
        assert [(i.command, i.x) for i in back[1:]] == [(i.command, i.x) for i in items[1:]]

        action.set_takeoff_altitude(10.0)
        action.arm()
        wait(telemetry.armed)
        action.takeoff()
        wait(lambda: telemetry.position().relative_altitude_m > 9.0)
        assert telemetry.in_air()
        action.land()
        wait(lambda: not telemetry.armed(), 60.0)
        assert telemetry.position().absolute_altitude_m == pytest.approx(3.0, abs=0.1)
    finally:
        client.destroy()
        process.terminate()
        process.wait(timeout=10.0)
