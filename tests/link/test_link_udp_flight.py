"""A mission drawn as in the paper, flown over real UDP on the wall clock, a link a station, both autopilots at once."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

import sitl_fixtures
from flight_processes import Events, simulator
from gcs.flight import FlightState
from gcs.mission import Mission
from gcs.plan import Plan
from gcs.planning import plan_mission
from link.report import report_flight
from link.supervisor import start_flight

SPEEDUP = 4.0
RATE_HZ = 20.0


@cache
def paper_plan() -> Plan:
    """The shortest of the thirty-station missions that is feasible with the default options."""
    path = Path(sitl_fixtures.__file__).parent / "missions" / "paper_like" / "M30_09.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    del document["options"]
    return plan_mission(Mission.from_document(document))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_both_autopilots_fly_a_mission_of_the_papers_kind_at_the_same_time(tmp_path: Path) -> None:
    plan = paper_plan()
    with simulator(plan, "px4", SPEEDUP) as one, simulator(plan, "ardupilot", SPEEDUP) as two:
        flights = {}
        for autopilot, vehicle in (("px4", one), ("ardupilot", two)):
            request = vehicle.request(
                plan, autopilot, SPEEDUP, rate_hz=RATE_HZ, log_path=str(tmp_path / f"{autopilot}.tlog")
            )
            events = Events()
            flights[autopilot] = (start_flight(request, events, run_dir=tmp_path / autopilot), events)
        results = {autopilot: flight.wait(240.0) for autopilot, (flight, _) in flights.items()}
    for autopilot, (_, events) in flights.items():
        result = results[autopilot]
        assert (result.state, result.exit_code) == (FlightState.COMPLETED, 0), events.all[-5:]
        report = report_flight(tmp_path / f"{autopilot}.tlog", plan)
        assert report.autopilot == autopilot
        assert report.reached
        assert report.plan_sha256 == plan.plan_sha256
        # Every handover of the plan, at its time, from the station in control to the next, and no other.
        assert [(h.index, h.from_station, h.to_station) for h in report.handovers] == [
            (h.index, h.from_station, h.to_station) for h in plan.handovers
        ]
        for flown, planned in zip(report.handovers, plan.handovers, strict=True):
            assert flown.flown_s == pytest.approx(planned.time_s, abs=1.0)
        assert report.tracking_rms_m is not None
        assert report.tracking_rms_m < 6.0
        assert report.off_path_worst_m is not None
        assert report.off_path_worst_m < 3.0
        assert report.margin_least_m is not None
        assert report.margin_least_m > 0.0
        assert sum(report.setpoints_by_station.values()) == report.setpoints
        assert report.setpoints > 0.9 * plan.mission_time_s * RATE_HZ
        text = report.to_text()
        assert "not planned" not in text
        assert "rms" in text
