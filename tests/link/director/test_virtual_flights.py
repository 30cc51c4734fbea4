"""Small flights in virtual time: nominal, with links that die at handovers, with every kind of fault.

What every flight must hold: each setpoint the vehicle obeyed was sent by the station in control at that moment, and
no two setpoints it obeyed lie further apart than two sample periods across a handover (where no link is bad).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import sitl_fixtures
from gcs.flight import FlightState
from tests.support.flights.virtual import VirtualFlight, handover_gaps_s, one_station_at_a_time
from tests.support.link.recordings import load
from tests.support.plans.planned import relay_plan

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
MISSIONS = Path(sitl_fixtures.__file__).parent / "missions"


def rest_error_m(one: VirtualFlight) -> float:
    """Horizontal distance of the landed vehicle from the plan's destination."""
    east, north = one.plan.plane.to_plane(one.vehicle.body.lat_deg, one.vehicle.body.lon_deg)
    end = one.plan.trajectory.evaluate(one.plan.mission_time_s)
    return float(np.hypot(east - end[0], north - end[1]))


@pytest.mark.slow
@BOTH
def test_a_flight_over_three_stations(autopilot: str) -> None:
    one = VirtualFlight(relay_plan(3), autopilot, frugal=True)
    assert one.run(limit_s=400.0) is FlightState.COMPLETED
    one_station_at_a_time(one)
    # The exported schedule is the one flown: each handover at the first sample at or after its time.
    launched = one.core.context.timeline.launched_s
    assert launched is not None
    for event, planned in zip(one.said("handover", state="requested"), one.plan.handovers, strict=True):
        assert 0.0 <= event.time_s - launched - planned.time_s < 0.05 + 1e-6
    assert max(handover_gaps_s(one)) <= 0.1 + 1e-9
    assert one.cross_track_m().max() < 1.0
    assert one.said("result")[0].data["tracking_rms_m"] < 1.0
    assert rest_error_m(one) < 0.5
    assert not one.said("alarm")


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("which", ["old", "new"])
@pytest.mark.parametrize("handover", [1, 2])
def test_a_link_dead_before_a_handover_ends_in_one_owner_and_in_coverage(
    autopilot: str, which: str, handover: int
) -> None:
    """The old station's link dies within the overlap: the next takes over. The next one's: the flight turns back."""
    planned = relay_plan(3).handovers[handover - 1]
    dead = planned.from_station if which == "old" else planned.to_station
    one = VirtualFlight(relay_plan(3), autopilot, frugal=True, request={"wait_for_station_s": 5.0})
    one.run(until=lambda: one.plan_s >= max(planned.time_s - 2.0, planned.overlap_start_s + 0.5), limit_s=200.0)
    one.proxy.cuts.append((dead, one.now_s, 1e9))
    end = one.run(limit_s=500.0)
    one_station_at_a_time(one)
    assert not one.vehicle.autopilot.armed
    if which == "old":
        assert end is FlightState.COMPLETED
        patience_s = {"px4": 0.6, "ardupilot": 1.8}[autopilot]
        assert max(handover_gaps_s(one)) <= patience_s + 0.15
        assert one.cross_track_m().max() < 2.0
    else:
        assert end is FlightState.CONTINGENCY
        assert "returning" in one.states
        # It stopped inside the old station's coverage: the path beyond it was not flown.
        furthest = max(t.plan_s for t in one.truth if t.plan_s is not None)
        assert furthest < planned.overlap_end_s


def test_real_px4_echoes_name_the_setpoint_they_hold() -> None:
    """From a recorded flight: what the monitor believes about echoes is what a real PX4 says."""
    from types import SimpleNamespace

    from link.telemetry.setpoint_echo import EchoTracker, Sent

    echoes, named, asked = EchoTracker(runs_on=False), 0, 0
    for line in load("px4-nominal")[1]:
        f = line.get("fields", {})
        if line.get("msg") == "SET_POSITION_TARGET_LOCAL_NED" and f["type_mask"] == 3072:
            echoes.note(
                Sent(
                    line["t"],
                    "a",
                    1,
                    (f["x"], f["y"], f["z"]),
                    (f["vx"], f["vy"], f["vz"]),
                    (f["afx"], f["afy"], f["afz"]),
                )
            )
        elif line.get("msg") == "POSITION_TARGET_LOCAL_NED" and 30.0 < line["t"] < 85.0:
            asked += 1
            held = echoes.held(SimpleNamespace(**f))
            named += bool(held) and line["t"] - held[-1].sent_s < 0.3
    assert asked > 200
    assert named > 0.97 * asked
