"""Setpoint files: the contract's CSV to the digit, JSON lines, and logs that other programs' tools read."""

from __future__ import annotations

import csv
import io
import json
import math
import struct
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil

from gcs.plan.model import Plan
from link.autopilot.local_frame import EkfOrigin, ardupilot_lat_lon_deg
from link.files.setpoint_files import COLUMNS, setpoint_file
from link.setpoints.sampler import SetpointSampler
from tests.support.plans.drawn import drawn_relay_plan, make_plan, rest_to_rest, with_handovers

HEADER = (
    "time_s,station,north_m,east_m,down_m,vn_m_s,ve_m_s,vd_m_s,an_m_s2,ae_m_s2,ad_m_s2,"
    "yaw_deg,lat_deg,lon_deg,alt_amsl_m,handover"
)
LAUNCH = datetime(2026, 11, 22, 9, 0, 0, 250_000, tzinfo=UTC)


def content(plan: Plan, rate_hz: float, kind: str, **options: object) -> bytes:
    return b"".join(setpoint_file(plan, rate_hz, kind, **options))  # type: ignore[arg-type]


# ---------------------------------------------------------------- CSV


def test_csv_by_hand() -> None:
    """100 m east in 10 s, three control points at each end: at half time 50 m, 1.875 * 10 m/s and no acceleration."""
    plan = make_plan(rest_to_rest((0, 0, 100), (100, 0, 100), duration_s=10.0))
    lines = content(plan, 0.2, "csv").decode().splitlines()
    assert lines[0] == HEADER
    assert len(lines) == 4
    assert lines[1].startswith("0.000000,den-helder,0.0000,0.0000,-100.0000,0.00000,0.00000,0.00000,0.00000,")
    middle = lines[2].split(",")
    assert middle[:5] == ["5.000000", "den-helder", "0.0000", "50.0000", "-100.0000"]
    assert middle[5:11] == ["0.00000", "18.75000", "0.00000", "0.00000", "0.00000", "0.00000"]
    assert middle[12] == "52.999999998"  # a geodesic that leaves eastward bends towards the equator
    assert middle[14:] == ["110.0000", ""]
    assert "-0.0000" not in "".join(lines)


def test_csv_is_the_curve_to_the_written_digit() -> None:
    plan = drawn_relay_plan()
    rows = list(csv.DictReader(io.StringIO(content(plan, 20.0, "csv").decode())))
    assert len(rows) == 6001
    time = np.array([float(row["time_s"]) for row in rows])
    assert time[-1] == 300.0

    def columns(*names: str) -> np.ndarray:  # type: ignore[type-arg]
        return np.array([[float(row[name]) for name in names] for row in rows])

    ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    for order, names, half in (
        (0, ("north_m", "east_m", "down_m"), 0.5e-4),
        (1, ("vn_m_s", "ve_m_s", "vd_m_s"), 0.5e-5),
        (2, ("an_m_s2", "ae_m_s2", "ad_m_s2"), 0.5e-5),
    ):
        exact = plan.trajectory.evaluate(time, order) @ ned
        assert np.abs(columns(*names) - exact).max() <= half * 1.001
    lat, lon = plan.plane.to_geodetic(*plan.trajectory.evaluate(time)[:, :2].T)
    assert np.abs(columns("lat_deg", "lon_deg") - np.column_stack([lat, lon])).max() <= 0.5001e-9
    # Altitude is the origin's plus up.
    assert np.abs(columns("alt_amsl_m") + columns("down_m") - 10.0).max() <= 1.01e-4
    assert ((columns("yaw_deg") >= 0.0) & (columns("yaw_deg") < 360.0)).all()


def test_csv_digits_and_handovers() -> None:
    rows = [line.split(",") for line in content(drawn_relay_plan(), 3.0, "csv").decode().splitlines()[1:]]
    decimals = [6, None, 4, 4, 4, 5, 5, 5, 5, 5, 5, 9, 9, 9, 4]
    for row in rows:
        for value, digits in zip(row, decimals, strict=False):
            assert digits is None or len(value.rpartition(".")[2]) == digits
    assert [(row[0], row[1], row[-1]) for row in rows if row[-1]] == [
        ("100.000000", "texel", "1"),
        ("200.666667", "vlieland", "2"),
    ]


def test_csv_yaw_of_360_is_written_as_0() -> None:
    """Due north with a hair of west: 359.99999999996 degrees."""
    plan = make_plan(rest_to_rest((0, 0, 50), (-1e-9, 1000, 50), duration_s=60.0))
    yaws = {row["yaw_deg"] for row in csv.DictReader(io.StringIO(content(plan, 2.0, "csv").decode()))}
    assert yaws == {"0.000000000"}


# ---------------------------------------------------------------- JSON lines


def test_jsonl_has_the_same_names_and_unrounded_numbers() -> None:
    plan = drawn_relay_plan()
    rows = [json.loads(line) for line in content(plan, 5.0, "jsonl").decode().splitlines()]
    samples = list(SetpointSampler(plan, 5.0))
    assert len(rows) == len(samples)
    for row, sample in zip(rows, samples, strict=True):
        assert tuple(row) == COLUMNS
        assert row["time_s"] == sample.time_s
        assert row["lat_deg"] == sample.lat_deg
        assert row["east_m"] == sample.position_enu_m[0]
        assert row["vd_m_s"] == -sample.velocity_enu_m_s[2] + 0.0
        assert (row["station"], row["handover"]) == (sample.station_id, sample.handover)


# ---------------------------------------------------------------- telemetry logs


def read_with_mavutil(path: Path) -> list[object]:
    log = mavutil.mavlink_connection(str(path), dialect="common")
    messages = []
    while (message := log.recv_match()) is not None:
        messages.append(message)
    log.close()
    return messages


@pytest.mark.slow
def test_px4_log_read_back_by_mavutil(tmp_path: Path) -> None:
    plan = drawn_relay_plan()
    path = tmp_path / "plan.tlog"
    path.write_bytes(content(plan, 20.0, "tlog", autopilot="px4", launch=LAUNCH))
    messages = read_with_mavutil(path)
    samples = list(SetpointSampler(plan, 20.0))
    setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"]
    assert len(setpoints) == len(samples)
    for message, sample in zip(setpoints, samples, strict=True):
        assert message._timestamp == pytest.approx(LAUNCH.timestamp() + sample.time_s, abs=2e-6)
        assert (message.get_srcSystem(), message.get_srcComponent()) == (sample.system_id, 190)
        assert (message.target_system, message.coordinate_frame, message.type_mask) == (1, 5, 0x0C00)
        assert message.time_boot_ms == int(sample.time_s * 1000)
        assert abs(message.lat_int * 1e-7 - sample.lat_deg) <= 0.501e-7
        assert abs(message.lon_int * 1e-7 - sample.lon_deg) <= 0.501e-7
        assert message.alt == pytest.approx(sample.alt_amsl_m, rel=1e-7)
        assert (message.vx, message.vy, message.vz) == pytest.approx(sample.velocity_ned_m_s, rel=1e-6, abs=1e-12)
        assert (message.afx, message.afy, message.afz) == pytest.approx(
            sample.acceleration_ned_m_s2, rel=1e-6, abs=1e-12
        )
    # Each station numbers its own frames without a gap.
    for system in (241, 242, 243):
        sequence = [m.get_seq() for m in messages if m.get_srcSystem() == system]
        assert sequence == [i % 256 for i in range(len(sequence))]


@pytest.mark.slow
def test_ardupilot_log_is_in_its_own_frame_from_the_origin_it_names(tmp_path: Path) -> None:
    plan = drawn_relay_plan()
    path = tmp_path / "plan.tlog"
    path.write_bytes(content(plan, 10.0, "tlog", autopilot="ardupilot"))
    messages = read_with_mavutil(path)
    origins = [m for m in messages if m.get_type() == "SET_GPS_GLOBAL_ORIGIN"]
    assert [(o.latitude, o.longitude, o.altitude) for o in origins] == [(530_000_000, 48_000_000, 10_000)]
    origin = EkfOrigin(53.0, 4.8, 10.0)
    setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
    samples = list(SetpointSampler(plan, 10.0))
    assert len(setpoints) == len(samples)
    for message, sample in zip(setpoints, samples, strict=True):
        assert (message.coordinate_frame, message.type_mask) == (1, 0x0C00)
        lat, lon = ardupilot_lat_lon_deg(origin, message.x, message.y)
        # float32 metres at 6 km: a quarter of a millimetre, 5e-9 degrees.
        assert (lat, lon) == pytest.approx((sample.lat_deg, sample.lon_deg), abs=1e-8)
        assert message.z == pytest.approx(-sample.position_enu_m[2], abs=1e-4)
        assert (message.vx, message.vy, message.vz) == pytest.approx(sample.velocity_ned_m_s, rel=1e-6, abs=1e-12)


def test_a_log_for_another_origin(tmp_path: Path) -> None:
    origin = EkfOrigin(53.01, 4.85, 2.0)
    plan = drawn_relay_plan()
    path = tmp_path / "plan.tlog"
    path.write_bytes(content(plan, 1.0, "tlog", autopilot="ardupilot", origin=origin))
    first = next(m for m in read_with_mavutil(path) if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED")
    # 0.01 degrees south of that origin, and 0.05 west: by ArduPilot's 0.01113188 m per 1e-7 degree.
    assert first.x == pytest.approx(-1113.188, abs=1e-2)
    assert first.y == pytest.approx(-5565.942 * math.cos(math.radians(53.005)), abs=1e-2)
    assert first.z == pytest.approx(2.0 - 100.0)


def test_heartbeats_come_from_the_station_in_control_every_second(tmp_path: Path) -> None:
    path = tmp_path / "plan.tlog"
    path.write_bytes(content(drawn_relay_plan(), 20.0, "tlog"))
    beats = [m for m in read_with_mavutil(path) if m.get_type() == "HEARTBEAT"]
    base = datetime(2000, 1, 1, tzinfo=UTC).timestamp()
    times = [(round(m._timestamp - base, 6), m.get_srcSystem()) for m in beats]
    assert times[:3] == [(0.0, 241), (1.0, 241), (2.0, 241)]
    # The newcomer speaks at once, then on the second.
    around = [(t, s) for t, s in times if 199.5 < t < 202.5]
    assert around == [(200.0, 242), (200.5, 243), (201.0, 243), (202.0, 243)]
    assert {(m.type, m.autopilot) for m in beats} == {(6, 8)}
    assert max(np.diff([t for t, _ in times])) <= 1.0


@pytest.mark.parametrize(
    ("autopilot", "kind"), [("px4", "SET_POSITION_TARGET_GLOBAL_INT"), ("ardupilot", "SET_POSITION_TARGET_LOCAL_NED")]
)
def test_mavlogdump_reads_the_log(tmp_path: Path, autopilot: str, kind: str) -> None:
    """pymavlink's own program, as a user would run it."""
    plan = drawn_relay_plan(duration_s=60.0, handovers_s=(20.0, 40.5))
    path = tmp_path / "plan.tlog"
    path.write_bytes(content(plan, 5.0, "tlog", autopilot=autopilot, launch=LAUNCH))
    tool = [sys.executable, "-m", "pymavlink.tools.mavlogdump", "--format", "json", "--types", kind, str(path)]
    done = subprocess.run(tool, capture_output=True, text=True, check=True, timeout=60)
    rows = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    samples = list(SetpointSampler(plan, 5.0))
    assert len(rows) == len(samples) == 301
    for row, sample in zip(rows, samples, strict=True):
        assert row["meta"]["type"] == kind
        assert row["meta"]["timestamp"] == pytest.approx(LAUNCH.timestamp() + sample.time_s, abs=2e-6)
        assert row["data"]["vx"] == pytest.approx(sample.velocity_ned_m_s[0], rel=1e-6, abs=1e-12)
        if autopilot == "px4":
            assert abs(row["data"]["lat_int"] - sample.lat_deg * 1e7) <= 0.501


def test_log_stamps_are_microseconds_big_endian() -> None:
    first = content(drawn_relay_plan(), 1.0, "tlog", launch=LAUNCH)[:9]
    stamp, marker = struct.unpack(">QB", first)
    assert marker == 0xFD
    assert stamp == 1_795_338_000_250_000  # 2026-11-22T09:00:00.25Z


# ---------------------------------------------------------------- the door, and pieces


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"file_format": "xlsx"}, r"format is 'xlsx', allowed are csv, jsonl, tlog"),
        ({"autopilot": "betaflight"}, r"autopilot is 'betaflight', allowed are px4, ardupilot"),
        ({"rate_hz": 0.0}, r"rate_hz is 0.0, allowed is"),
        ({"file_format": "tlog", "launch": datetime(2026, 11, 22, 9)}, r"without a time zone"),
    ],
)
def test_bad_options_are_refused_before_the_first_piece(change: dict[str, object], message: str) -> None:
    options: dict[str, object] = {"rate_hz": 20.0, "file_format": "csv", **change}
    with pytest.raises(ValueError, match=message):
        setpoint_file(drawn_relay_plan(), **options)  # type: ignore[arg-type]


def test_pieces_come_one_at_a_time() -> None:
    """A stream of 200 Hz for twenty minutes: the first piece holds some thousand samples, not 240,001."""
    plan = make_plan(with_handovers(rest_to_rest((0, 0, 90), (9000, 0, 90), duration_s=1200.0), (600.0,)))
    pieces = setpoint_file(plan, 200.0, "csv")
    assert next(pieces).decode().strip() == HEADER
    assert len(next(pieces).splitlines()) == 4096
