"""Logs of flights: a flight a file, read by others, each message once; what is wrong with one is told."""

from __future__ import annotations

import io
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest
from pymavlink import mavutil

from link.errors import ReportError
from link.files.flight_report import report_flight
from link.files.tlog import read_tlog
from tests.support.flights.recorded import plan, recorded, records, stepped

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
PLAN = plan()


def written(tmp_path: Path, log: bytes) -> Path:
    path = tmp_path / "flight.tlog"
    path.write_bytes(log)
    return path


@pytest.mark.slow
@BOTH
def test_other_programs_find_attitude_and_satellites_in_a_log(autopilot: str, tmp_path: Path) -> None:
    path = written(tmp_path, recorded(autopilot))
    reader = mavutil.mavlink_connection(str(path), dialect="common")
    kinds: Counter[str] = Counter()
    links = set()
    while (message := reader.recv_match()) is not None:
        kinds[message.get_type()] += 1
        links.add(message._link)
    reader.close()
    seconds = PLAN.mission_time_s
    assert kinds["ATTITUDE"] > 3 * seconds
    assert kinds["GPS_RAW_INT"] > 1.5 * seconds
    assert kinds["BAD_DATA"] == 0
    assert len(links) > 1


@pytest.mark.slow
def test_mavtogpx_shows_the_flight(tmp_path: Path) -> None:
    path = written(tmp_path, recorded())
    script = Path(sys.executable).with_name("mavtogpx.py")
    done = subprocess.run([sys.executable, str(script), str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "flight.tlog.gpx").read_text().count("<trkpt") > PLAN.mission_time_s


@BOTH
@pytest.mark.slow
def test_each_message_of_the_vehicle_once_however_many_links_brought_it(autopilot: str) -> None:
    bodies = Counter(
        (record.message.get_type(), record.frame[5 : 10 + record.frame[1]])
        for record in read_tlog(io.BytesIO(recorded(autopilot)))
        if record.message.get_srcSystem() == 1 and hasattr(record.message, "time_boot_ms")
    )
    assert sum(bodies.values()) > 1000
    assert max(bodies.values()) == 1


def test_a_whole_log_is_told_as_whole_and_its_flight_as_planned(tmp_path: Path) -> None:
    report = report_flight(written(tmp_path, recorded()), PLAN)
    assert report.damage.lines == ()
    assert report.not_planned == ()
    assert "Flown         flown as planned\n" in report.to_text()


def test_a_hole_is_no_gap_of_the_stream(tmp_path: Path) -> None:
    log = recorded()
    whole = report_flight(written(tmp_path, log), PLAN)
    half = len(log) // 2
    holed = report_flight(written(tmp_path, log[:half] + log[half + 5000 :]), PLAN)
    assert holed.longest_gap_s == pytest.approx(whole.longest_gap_s, abs=0.01)
    assert holed.damage.missing_frames > 5
    assert "frames of the stations are missing" in holed.to_text()
    assert holed.tracking_worst_m == pytest.approx(whole.tracking_worst_m, abs=0.2)


@pytest.mark.parametrize("by_s", [-3600.0, 3600.0, -5.0, 86400.0])
def test_a_stepped_ground_clock_is_told_and_judged_by_the_vehicles(by_s: float, tmp_path: Path) -> None:
    log = recorded()
    whole = report_flight(written(tmp_path, log), PLAN)
    report = report_flight(written(tmp_path, stepped(log, by_s)), PLAN)
    assert [step for _, step in report.damage.clock_steps] == [pytest.approx(by_s, abs=0.3)]
    assert report.flown_s == pytest.approx(whole.flown_s, abs=0.3)
    assert report.tracking_rms_m == pytest.approx(whole.tracking_rms_m, abs=0.5)
    assert report.reached


def test_two_flights_in_one_log_are_told_and_each_is_reported(tmp_path: Path) -> None:
    log = recorded()
    later = stepped(log, 7200.0, 0.0)
    path = written(tmp_path, log + later)
    one, two = (report_flight(path, PLAN, flight=number) for number in (1, 2))
    assert (one.flights, one.flight, two.flight) == (2, 1, 2)
    assert "Flights       2 in this log; this is number 1" in one.to_text()
    assert two.launched_unix_s - one.launched_unix_s == pytest.approx(7200.0, abs=1.0)
    assert one.setpoints == two.setpoints
    assert one.tracking_worst_m == pytest.approx(two.tracking_worst_m, abs=0.01)
    assert [link.probes for link in one.links] == pytest.approx([link.probes for link in two.links], abs=2)
    with pytest.raises(ReportError, match=r"holds 2 flight\(s\) of this plan, none of number 3"):
        report_flight(path, PLAN, flight=3)


def test_a_log_that_ends_in_the_air_is_not_told_as_flown_as_planned(tmp_path: Path) -> None:
    pieces = records(recorded())
    report = report_flight(written(tmp_path, b"".join(pieces[: len(pieces) // 2])), PLAN)
    assert "not flown to its end" in report.not_planned
    assert any("ends while the vehicle is armed" in line for line in report.damage.lines)
