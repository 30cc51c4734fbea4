"""What the report says of the links: hand-made probes in a log, and events beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from gcs.flight import EventKind, FlightEvent, FlightState
from link.dialect import mavlink
from link.errors import ReportError
from link.files.flight_report import report_flight
from link.files.link_report import History, LinkReport
from link.files.tlog import TlogWriter
from link.setpoints.sampler import SetpointSampler
from link.wire.codec import StationCodec
from tests.support.plans.planned import relay_plan

START_US = 1_795_000_000_000_000
PLAN = relay_plan(2)
IDS = {"s1": 241, "s2": 242}


def event(kind: EventKind, **data: object) -> bytes:
    one = FlightEvent(1, kind, 0.0, None, "2026-11-22T09:00:00Z", FlightState.CRUISE, data)
    return json.dumps(one.to_document()).encode() + b"\n"


LATENESS = {"counts_by_ms": {"0.1": 5}, "p50_ms": 0.1, "p99_ms": 0.2, "worst_ms": 0.7, "skipped_ticks": 3}


def result(plan_sha256: str = PLAN.plan_sha256) -> bytes:
    return event(EventKind.RESULT, plan_sha256=plan_sha256, lateness=LATENESS)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plan's setpoints at 20 Hz, one of them 30 ms late, and s1's probes: five, of which one is lost."""
    path = tmp_path_factory.mktemp("report") / "flight.tlog"
    codecs = {s: StationCodec(number) for s, number in IDS.items()}
    vehicle = StationCodec(1, 1)
    records: list[tuple[float, bytes]] = []
    # But for the last, which is at the mission time, between two ticks.
    for k, setpoint in enumerate(list(SetpointSampler(PLAN, 20.0))[:-1]):
        message = mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, 0, round(setpoint.lat_deg * 1e7), round(setpoint.lon_deg * 1e7), setpoint.alt_amsl_m,
            *setpoint.velocity_ned_m_s, 0.0, 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        records.append((setpoint.time_s + (0.03 if k == 100 else 0.0), codecs[setpoint.station_id].encode(message)))
    # Round trips of 100, 140, 100 and 120 ms; the third is never answered, the first answer comes over two ways.
    for number, trip_s in enumerate((0.1, 0.14, None, 0.1, 0.12), 1):
        sent_s = 2.0 * number
        records.append((sent_s, codecs["s1"].encode(mavlink.MAVLink_timesync_message(0, number))))
        for late_s in (0.0, 0.5) if trip_s is not None else ():
            answer = mavlink.MAVLink_timesync_message(77, number)
            records.append((sent_s + (trip_s or 0.0) + late_s, vehicle.encode(answer)))
    # The vehicle's own question, an answer to nobody, another component's answer, and a probe still on its way.
    records.append((4.5, vehicle.encode(mavlink.MAVLink_timesync_message(0, 1))))
    records.append((4.6, vehicle.encode(mavlink.MAVLink_timesync_message(5, 999))))
    records.append((6.2, StationCodec(1, 191).encode(mavlink.MAVLink_timesync_message(5, 3))))
    end_s = PLAN.mission_time_s
    records.append((end_s - 0.5, codecs["s1"].encode(mavlink.MAVLink_timesync_message(0, 50))))
    with TlogWriter(path) as writer:
        for time_s, frame in sorted(records):
            writer.write(frame, START_US + round(time_s * 1e6))
    return path


def test_loss_latency_and_jitter_of_each_station_come_from_its_probes(log: Path) -> None:
    report = report_flight(log, PLAN)
    first, second = report.links
    assert first.loss == pytest.approx(1 / 5)
    assert (first.station, first.probes, first.failovers) == ("s1", 5, None)
    assert first.latency_ms == pytest.approx(55.0, abs=1e-3)  # the median of 100, 100, 120, 140 is 110
    assert first.round_trip_worst_ms == pytest.approx(140.0, abs=1e-3)
    assert first.jitter_ms == pytest.approx((40.0 + 40.0 + 20.0) / 3.0, abs=1e-3)
    assert second == LinkReport("s2", 0, None, None, None, None)
    text = report.to_text()
    assert (
        "  s1: 20.0% of 5 probes lost, latency 55 ms, jitter 33 ms, there and back 140 ms at worst\n"
        "  s2: no probes\n" in text
    )
    assert report.to_document()["links"][0]["probes"] == 5
    assert (report.lateness_from, report.skipped_ticks) == ("log", None)
    assert report.lateness_p99_ms < 0.01
    assert report.lateness_worst_ms == pytest.approx(30.0, abs=0.01)


def test_events_add_failovers_and_the_streamers_own_count(log: Path, tmp_path: Path) -> None:
    events = tmp_path / "events.jsonl"
    moved = [event(EventKind.LINK, station="s1", url=url, before="x") for url in "ab"]
    events.write_bytes(b"".join([*moved, result()]) + b'{"cut sho')
    report = report_flight(log, PLAN, events)
    assert [link.failovers for link in report.links] == [2, 0]
    assert "at worst, another link path sent 2 times\n" in report.to_text()
    assert (report.lateness_p50_ms, report.lateness_p99_ms, report.lateness_worst_ms) == (0.1, 0.2, 0.7)
    assert (report.lateness_from, report.skipped_ticks) == ("streamer", 3)
    assert "worst 0.7 ms, 3 skipped (the streamer's own count)\n" in report.to_text()


def test_events_of_a_flight_that_has_not_ended_tell_failovers_alone(log: Path, tmp_path: Path) -> None:
    events = tmp_path / "events.jsonl"
    events.write_bytes(event(EventKind.LINK, station="s2", url="a", before="b"))
    report = report_flight(log, PLAN, events)
    assert [link.failovers for link in report.links] == [0, 1]
    assert report.lateness_from == "log"


def test_events_are_of_this_plan_or_of_one_it_was_flown_after(tmp_path: Path) -> None:
    events = tmp_path / "events.jsonl"
    events.write_bytes(result("f" * 64))
    with pytest.raises(ReportError, match=r"are of a flight of another plan \(f{16}\)"):
        History.read(events, PLAN)
    events.write_bytes(event(EventKind.REPLANNED, before=PLAN.plan_sha256, plan_sha256="f" * 64) + result("f" * 64))
    assert History.read(events, PLAN) == History({}, LATENESS)


@pytest.mark.parametrize("line", [b"[]", b"{}", b"no json", b'{"sequence": 1, "kind": "link"}', b"\xff"])
def test_a_file_that_holds_no_events_is_told_with_its_line(line: bytes, tmp_path: Path) -> None:
    events = tmp_path / "events.jsonl"
    events.write_bytes(result() + line + b"\n")
    with pytest.raises(ReportError, match=r"events\.jsonl, line 2: not an event of a flight"):
        History.read(events, PLAN)
    with pytest.raises(ReportError, match="No such file"):
        History.read(tmp_path / "none", PLAN)


@pytest.mark.parametrize("way_s", [0.0, 0.05, 0.2])
def test_what_frames_take_is_no_error_of_the_vehicle(tmp_path: Path, way_s: float) -> None:
    """A vehicle that is where the newest setpoint it has asks it to be, on links that take ``way_s`` each way."""
    codecs, vehicle = {s: StationCodec(number) for s, number in IDS.items()}, StationCodec(1, 1)
    records: list[tuple[float, bytes]] = []
    for setpoint in list(SetpointSampler(PLAN, 20.0))[:-1]:
        lat, lon = round(setpoint.lat_deg * 1e7), round(setpoint.lon_deg * 1e7)
        message = mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, 0, lat, lon, setpoint.alt_amsl_m, *setpoint.velocity_ned_m_s, 0.0, 0.0, 0.0, 0.0, 0.0
        )
        records.append((setpoint.time_s, codecs[setpoint.station_id].encode(message)))
        there_s = setpoint.time_s + way_s
        place = mavlink.MAVLink_global_position_int_message(
            round(5e3 + there_s * 1e3), lat, lon, round(setpoint.alt_amsl_m * 1e3), 0, 0, 0, 0, 0
        )
        records.append((there_s + way_s, vehicle.encode(place)))
    for number, station in enumerate(("s1", "s2"), 1):
        records.append((float(number), codecs[station].encode(mavlink.MAVLink_timesync_message(0, number))))
        records.append((number + 2.0 * way_s, vehicle.encode(mavlink.MAVLink_timesync_message(77, number))))
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as log:
        for time_s, frame in sorted(records, key=lambda record: record[0]):
            log.write(frame, START_US + round(time_s * 1e6))
    report = report_flight(path, PLAN)
    assert report.tracking_rms_m is not None
    # A millisecond of the vehicle's clock at 15 m/s, and a figure in the seventh decimal of a degree.
    assert report.tracking_rms_m < 0.05
    assert report.tracking_worst_m is not None
    assert report.tracking_worst_m < 0.2
