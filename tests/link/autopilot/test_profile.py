"""What each autopilot is sent: its message, frame and mask, its own projection, and nothing that could not be meant.

The projections are held against hand-worked numbers, the planning plane, and what real autopilots said of themselves.
"""

from __future__ import annotations

import bisect
import dataclasses
import math

import numpy as np
import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given
from hypothesis import strategies as st

from gcs.geodesy.plane import Plane
from link.autopilot.local_frame import (
    EkfOrigin,
    ardupilot_lat_lon_deg,
    ardupilot_north_east_m,
    px4_lat_lon_deg,
    px4_north_east_m,
)
from link.autopilot.profile import MAX_ACCELERATION_M_S2, MAX_SPEED_M_S
from link.autopilot.registry import PROFILES
from link.dialect import mavlink
from link.errors import LinkError, MissingOrigin, UnsafeSetpoint
from link.microservices.parameter_value import Parameter
from link.setpoints.sampler import SetpointSampler
from link.setpoints.setpoint import Setpoint
from link.telemetry.vehicle_monitor import Heartbeat
from link.wire.codec import StationCodec
from tests.support.heartbeats import is_autopilot
from tests.support.link.recordings import NAMES, autopilot_of, load, received
from tests.support.plans.drawn import drawn_relay_plan

DEN_HELDER = EkfOrigin(53.0, 4.8, 12.5)
GOOD = Setpoint(
    time_s=12.3456,
    station_id="texel",
    system_id=242,
    leg=1,
    handover=None,
    position_enu_m=(1.0, 2.0, 3.0),
    velocity_enu_m_s=(9.0, 9.0, 9.0),
    acceleration_enu_m_s2=(9.0, 9.0, 9.0),
    lat_deg=53.1234567,
    lon_deg=4.9876543,
    alt_amsl_m=112.5,
    velocity_ned_m_s=(12.0, -5.0, 0.25),
    acceleration_ned_m_s2=(0.5, -0.25, 0.125),
    yaw_deg=337.38,
)


def over_the_wire(message):  # type: ignore[no-untyped-def]
    """What a vehicle reads: packed, sent, parsed."""
    (got,) = StationCodec(1, 1).decode(StationCodec(242).encode(message))
    return got


# ---------------------------------------------------------------- projections


def test_ardupilot_offsets_by_hand() -> None:
    """0.9 degrees north and 1.5 east of 53 N: the longitude shrinks by the cosine of the mean latitude, 53.45."""
    north, east = ardupilot_north_east_m(DEN_HELDER, 53.9, 6.3)
    assert north == pytest.approx(9_000_000 * 0.011131884502145034)
    assert east == pytest.approx(15_000_000 * 0.011131884502145034 * math.cos(math.radians(53.45)))
    assert (north, east) == pytest.approx((100_186.96, 99_439.6), abs=0.1)
    # With the origin's latitude alone, as before 4.1, it would be a kilometre more.
    assert 15_000_000 * 0.011131884502145034 * math.cos(math.radians(53.0)) - east == pytest.approx(1055, abs=5)


def test_px4_offsets_by_hand() -> None:
    """Due north: arc on a sphere of 6,371 km. On the equator due east: the same."""
    assert px4_north_east_m(DEN_HELDER, 53.9, 4.8) == pytest.approx((6_371_000 * math.radians(0.9), 0.0), abs=1e-6)
    equator = EkfOrigin(0.0, 179.9, 0.0)
    assert px4_north_east_m(equator, 0.0, -179.9) == pytest.approx((0.0, 6_371_000 * math.radians(0.2)), abs=1e-6)
    assert px4_north_east_m(DEN_HELDER, 53.0, 4.8) == (0.0, 0.0)


def test_they_differ_from_the_planning_plane_by_hundreds_of_metres() -> None:
    """The reason for all this: at 53 N PX4 is 0.33 % short east and 0.08 % north, ArduPilot 0.21 % and -0.03 %."""
    plane = Plane(53.0, 4.8)
    lat, lon = plane.to_geodetic([100_000.0, 0.0], [0.0, 100_000.0])
    px4_east = px4_north_east_m(DEN_HELDER, float(lat[0]), float(lon[0]))[1]
    ardupilot_east = ardupilot_north_east_m(DEN_HELDER, float(lat[0]), float(lon[0]))[1]
    px4_north = px4_north_east_m(DEN_HELDER, float(lat[1]), float(lon[1]))[0]
    ardupilot_north = ardupilot_north_east_m(DEN_HELDER, float(lat[1]), float(lon[1]))[0]
    # 100 km on the ellipsoid, as each of them counts it: curvature radii there are 6,391.8 km east, 6,376.2 km north.
    assert px4_east == pytest.approx(100_000 * 6371.0 / 6391.8, abs=10)
    assert px4_north == pytest.approx(100_000 * 6371.0 / 6376.2, abs=10)
    assert ardupilot_east == pytest.approx(100_000 * 6378.1 / 6391.8, abs=10)
    assert ardupilot_north == pytest.approx(100_000 * 6378.1 / 6376.2, abs=10)
    assert 100_000 - px4_east == pytest.approx(330, abs=10)


@given(
    lat0=st.floats(-84, 84),
    lon0=st.floats(-180, 180),
    course=st.floats(0, 2 * math.pi),
    distance_m=st.floats(0, 300_000),
)
def test_projections_invert(lat0: float, lon0: float, course: float, distance_m: float) -> None:
    origin = EkfOrigin(lat0, lon0, 0.0)
    north, east = distance_m * math.cos(course), distance_m * math.sin(course)
    for forward, inverse in (
        (px4_north_east_m, px4_lat_lon_deg),
        (ardupilot_north_east_m, ardupilot_lat_lon_deg),
    ):
        lat, lon = inverse(origin, north, east)
        assert -180.0 <= lon <= 180.0
        assert forward(origin, lat, lon) == pytest.approx((north, east), abs=1e-5)


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("ardupilot-mission", "px4-params-mission")])
def test_real_autopilots_agree_with_our_formulas(name: str) -> None:
    """LOCAL_POSITION_NED against GLOBAL_POSITION_INT of the same moment, as far from the origin as the flight went.

    To 3 cm (two roundings to a centimetre, 60 ms apart at low speed). The planning plane is up to 2.7 m off there.
    """
    origin_data = load(name)[0].get("origin")
    if origin_data is None:
        (_, told), *_ = received(name, "GPS_GLOBAL_ORIGIN")
        origin = EkfOrigin(told["latitude"] * 1e-7, told["longitude"] * 1e-7, told["altitude"] * 1e-3)
    else:
        origin = EkfOrigin(**origin_data)
    local = list(received(name, "LOCAL_POSITION_NED"))
    times = [t for t, _ in local]
    profile = PROFILES[autopilot_of(name)]
    compared = 0
    for t, place in received(name, "GLOBAL_POSITION_INT"):
        if math.hypot(place["vx"], place["vy"]) > 5:
            continue
        near = min(
            range(max(0, bisect.bisect(times, t) - 1), min(len(times), bisect.bisect(times, t) + 1)),
            key=lambda i: abs(times[i] - t),
        )
        if abs(times[near] - t) > 0.06:
            continue
        compared += 1
        got = profile.north_east_m(origin, place["lat"] * 1e-7, place["lon"] * 1e-7)
        assert got == pytest.approx((local[near][1]["x"], local[near][1]["y"]), abs=0.03)
    assert compared > 10


# ---------------------------------------------------------------- messages


def test_px4_message_field_by_field() -> None:
    got = over_the_wire(PROFILES["px4"].encode(GOOD, target_system=7, origin=None))
    assert got.get_type() == "SET_POSITION_TARGET_GLOBAL_INT"
    assert (got.target_system, got.target_component, got.coordinate_frame) == (7, 1, 5)
    assert got.type_mask == 0b1100_0000_0000
    assert got.time_boot_ms == 12345
    assert (got.lat_int, got.lon_int, got.alt) == (531234567, 49876543, 112.5)
    assert (got.vx, got.vy, got.vz) == (12.0, -5.0, 0.25)
    assert (got.afx, got.afy, got.afz) == (0.5, -0.25, 0.125)
    # 337.38 degrees is -22.62, for readers of logs; the mask tells the vehicle to choose its own.
    assert got.yaw == pytest.approx(math.radians(-22.62), abs=1e-6)
    assert got.yaw_rate == 0.0


def test_ardupilot_message_field_by_field() -> None:
    got = over_the_wire(PROFILES["ardupilot"].encode(GOOD, target_system=1, time_boot_ms=99, origin=DEN_HELDER))
    assert got.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
    assert (got.target_system, got.target_component, got.coordinate_frame) == (1, 1, 1)
    assert (got.type_mask, got.time_boot_ms) == (0x0C00, 99)
    assert got.x == pytest.approx(1_234_567 * 0.011131884502145034, abs=1e-3)
    assert got.y == pytest.approx(1_876_543 * 0.011131884502145034 * math.cos(math.radians(53.06172835)), abs=1e-3)
    # Down of the EKF origin, not of home: 112.5 - 12.5.
    assert got.z == -100.0
    assert (got.vx, got.vy, got.vz) == (12.0, -5.0, 0.25)
    assert (got.afx, got.afy, got.afz) == (0.5, -0.25, 0.125)


def test_ardupilot_is_not_sent_anything_before_its_origin_is_known() -> None:
    with pytest.raises(MissingOrigin, match="GPS_GLOBAL_ORIGIN"):
        PROFILES["ardupilot"].encode(GOOD, target_system=1)


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_the_place_meant_is_the_place_the_vehicle_goes_to(name: str) -> None:
    """100 km from the vehicle's origin the true target is within 2 cm of the plan (float32 steps by 8 mm there)."""
    profile = PROFILES[name]
    stream = SetpointSampler(drawn_relay_plan(), 0.5)
    there = Plane(53.0, 4.8).to_geodetic(-70_000.0, -71_000.0)
    origin = EkfOrigin(float(there[0]), float(there[1]), 3.0)
    for sample in stream:
        got = over_the_wire(profile.encode(sample, target_system=1, origin=origin))
        if name == "px4":
            lat, lon, alt = got.lat_int * 1e-7, got.lon_int * 1e-7, got.alt
        else:
            # What the vehicle makes of it: its own estimate is x, y when GNSS says this latitude and longitude.
            lat, lon = ardupilot_lat_lon_deg(origin, got.x, got.y)
            alt = origin.alt_amsl_m - got.z
        path = Geodesic.WGS84.Inverse(lat, lon, sample.lat_deg, sample.lon_deg)
        assert path["s12"] < 0.02
        assert alt == pytest.approx(sample.alt_amsl_m, abs=1e-4)


def test_one_mask_for_the_whole_flight_hold_included() -> None:
    """ArduCopter starts its controller anew when the mask changes; and only full triples are never misread."""
    sample = SetpointSampler(drawn_relay_plan(), 20.0).at(77.0)
    for profile in PROFILES.values():
        masks = {
            profile.encode(s, target_system=1, origin=DEN_HELDER).type_mask
            for s in (sample, sample.hold(), sample.retimed(0.3, -0.1))
        }
        assert masks == {0x0C00}


def test_frame_is_65_bytes_with_its_13_byte_signature_apart() -> None:
    full = dataclasses.replace(GOOD, yaw_deg=33.3)
    assert len(StationCodec(242).encode(PROFILES["px4"].encode(full, target_system=1))) <= 65


# ---------------------------------------------------------------- what must never be sent

SCALARS = ("time_s", "lat_deg", "lon_deg", "alt_amsl_m", "yaw_deg")
VECTORS = ("velocity_ned_m_s", "acceleration_ned_m_s2")


def broken(field: str, axis: int, value: float) -> Setpoint:
    if field in SCALARS:
        return dataclasses.replace(GOOD, **{field: value})
    vector = list(getattr(GOOD, field))
    vector[axis] = value
    return dataclasses.replace(GOOD, **{field: tuple(vector)})


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(("field", "axis"), [(f, 0) for f in SCALARS] + [(f, i) for f in VECTORS for i in range(3)])
def test_nan_and_infinity_are_refused_everywhere(name: str, field: str, axis: int, value: float) -> None:
    """PX4 stops dead at NaN in one axis; ArduPilot takes NaN and no longer follows good setpoints."""
    with pytest.raises(UnsafeSetpoint) as caught:
        PROFILES[name].encode(broken(field, axis, value), target_system=1, origin=DEN_HELDER)
    assert str(value) in str(caught.value)


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
@pytest.mark.parametrize(
    ("field", "axis", "value"),
    [
        ("lat_deg", 0, 91.0),  # PX4 would fly 4,848 km at full speed
        ("lat_deg", 0, -90.000001),
        ("lon_deg", 0, 180.0000001),
        ("lon_deg", 0, -541.0),
        ("alt_amsl_m", 0, 20_001.0),
        ("alt_amsl_m", 0, -1_001.0),
        ("time_s", 0, -0.001),
        ("time_s", 0, 5e6),
        ("yaw_deg", 0, 361.0),
        ("velocity_ned_m_s", 2, 341.0),
        ("velocity_ned_m_s", 0, -1e30),
        ("acceleration_ned_m_s2", 1, 201.0),
    ],
)
def test_values_out_of_range_are_refused_with_value_and_range(name: str, field: str, axis: int, value: float) -> None:
    with pytest.raises(UnsafeSetpoint, match="nothing was sent") as caught:
        PROFILES[name].encode(broken(field, axis, value), target_system=1, origin=DEN_HELDER)
    assert caught.value.value == value
    assert " to " in caught.value.allowed
    assert isinstance(caught.value, LinkError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"target_system": 0}, "target_system"),
        ({"target_system": 256}, "target_system"),
        ({"target_system": 1, "target_component": -1}, "target_component"),
        ({"target_system": 1, "time_boot_ms": 2**32}, "time_boot_ms"),
    ],
)
def test_broadcast_and_impossible_addresses_are_refused(options: dict[str, int], field: str) -> None:
    with pytest.raises(UnsafeSetpoint, match=field):
        PROFILES["px4"].encode(GOOD, **options)  # type: ignore[arg-type]


def test_local_coordinates_have_an_end() -> None:
    """Farther from the EKF origin than local coordinates mean anything, or near a pole."""
    profile = PROFILES["ardupilot"]
    with pytest.raises(UnsafeSetpoint, match="north_m"):
        profile.encode(dataclasses.replace(GOOD, lat_deg=40.0), target_system=1, origin=DEN_HELDER)
    with pytest.raises(UnsafeSetpoint, match="east_m"):
        profile.encode(dataclasses.replace(GOOD, lon_deg=-30.0), target_system=1, origin=DEN_HELDER)
    with pytest.raises(UnsafeSetpoint, match="lat_deg"):
        profile.encode(dataclasses.replace(GOOD, lat_deg=86.0), target_system=1, origin=EkfOrigin(84.9, 4.8, 0.0))
    with pytest.raises(UnsafeSetpoint, match=r"origin\.lat_deg"):
        profile.encode(dataclasses.replace(GOOD, lat_deg=84.9), target_system=1, origin=EkfOrigin(85.1, 4.8, 0.0))
    with pytest.raises(ValueError, match="no place on earth"):
        EkfOrigin(math.nan, 0.0, 0.0)


ANYTHING = st.one_of(
    st.floats(width=64),
    st.floats(-200, 200),
    st.sampled_from([math.nan, math.inf, -math.inf, 90.0, -90.0, 180.0, 2.0**31, 1e-320, 3.5e38]),
)


def check_wire(name: str, sample: Setpoint, origin: EkfOrigin) -> bool:
    """True if sent, and then every number on the wire is finite, in range and what was meant."""
    try:
        message = PROFILES[name].encode(sample, target_system=1, origin=origin)
    except UnsafeSetpoint:
        return False
    got = over_the_wire(message)
    for field in ("vx", "vy", "vz"):
        assert abs(getattr(got, field)) <= MAX_SPEED_M_S * (1 + 1e-6)
    for field in ("afx", "afy", "afz"):
        assert abs(getattr(got, field)) <= MAX_ACCELERATION_M_S2 * (1 + 1e-6)
    assert abs(got.yaw) <= math.pi * (1 + 1e-6)
    if name == "px4":
        assert abs(got.lat_int - sample.lat_deg * 1e7) <= 0.51
        assert abs(got.lon_int - sample.lon_deg * 1e7) <= 0.51
        assert abs(got.alt - sample.alt_amsl_m) <= 1e-3
    else:
        assert math.hypot(got.x, got.y) <= 1.5e6
        assert math.isfinite(got.z)
    return True


@given(st.lists(ANYTHING, min_size=11, max_size=11), st.sampled_from(["px4", "ardupilot"]))
def test_whatever_comes_in_nothing_unsafe_goes_out(numbers: list[float], name: str) -> None:
    sample = dataclasses.replace(
        GOOD,
        **dict(zip(SCALARS, numbers[:5], strict=True)),
        velocity_ned_m_s=tuple(numbers[5:8]),
        acceleration_ned_m_s2=tuple(numbers[8:11]),
    )
    check_wire(name, sample, DEN_HELDER)


@pytest.mark.soak
@pytest.mark.timeout(0)
def test_ten_million_random_setpoints() -> None:
    """Scorecard 17: NaN, infinity, out of range on the wire: 0 in 10^7."""
    rng = np.random.default_rng(17)
    special = np.array([math.nan, math.inf, -math.inf, 91.0, -181.0, 1e9, 2.0**31, 1e300])
    sent = 0
    for _ in range(1000):
        scale = np.array([500, 100, 200, 25_000, 400, 400, 400, 400, 250, 250, 250])
        block = rng.uniform(-1, 1, (10_000, 11)) * scale * rng.choice([1.0, 0.5, 0.1], (10_000, 1))
        hit = rng.random(block.shape) < 0.02
        block[hit] = rng.choice(special, hit.sum())
        for numbers in block.tolist():
            sample = dataclasses.replace(
                GOOD,
                **dict(zip(SCALARS, numbers[:5], strict=True)),
                velocity_ned_m_s=tuple(numbers[5:8]),
                acceleration_ned_m_s2=tuple(numbers[8:11]),
            )
            sent += check_wire("px4" if numbers[0] > 0 else "ardupilot", sample, DEN_HELDER)
    assert sent > 100_000


# ---------------------------------------------------------------- modes and heartbeats


def heartbeat(fields: dict[str, int], *, component: int = 1):  # type: ignore[no-untyped-def]
    names = ("type", "autopilot", "base_mode", "custom_mode", "system_status", "mavlink_version")
    message = mavlink.MAVLink_heartbeat_message(*(fields[n] for n in names))
    (got,) = StationCodec(255).decode(StationCodec(1, component).encode(message))
    return got


@pytest.mark.parametrize("name", NAMES)
def test_every_recorded_heartbeat_has_a_mode_we_know(name: str) -> None:
    profile = PROFILES[autopilot_of(name)]
    other = PROFILES["px4" if profile.name == "ardupilot" else "ardupilot"]
    numbers = {}
    for _, fields in received(name, "HEARTBEAT"):
        numbers[fields["custom_mode"], fields["base_mode"]] = fields
    for fields in numbers.values():
        beat = heartbeat(fields)
        assert is_autopilot(profile, beat)
        assert not is_autopilot(other, beat)
        mode = profile.mode_of(beat)
        assert mode in profile.modes
        assert profile.is_offboard(beat) == (mode in ("OFFBOARD", "GUIDED"))
        assert Heartbeat.from_message(0.0, beat).armed == bool(fields["base_mode"] & 128)


def test_modes_by_hand() -> None:
    beat = {"type": 2, "autopilot": 12, "base_mode": 0x9D, "system_status": 4, "mavlink_version": 3}
    px4 = PROFILES["px4"]
    for number, mode in (
        (6 << 16, "OFFBOARD"),
        (4 << 16 | 3 << 24, "HOLD"),
        (4 << 16 | 5 << 24, "RTL"),
        (4 << 16 | 6 << 24, "LAND"),
        (3 << 16, "POSCTL"),
        (3 << 16 | 1 << 24, "POSCTL"),  # a sub-mode (orbit) outside AUTO
        (4 << 16 | 77 << 24, f"mode {4 << 16 | 77 << 24}"),
        (0, "mode 0"),
    ):
        assert px4.mode_of(heartbeat({**beat, "custom_mode": number})) == mode
    assert px4.is_offboard(heartbeat({**beat, "custom_mode": 393216}))
    assert not px4.is_offboard(heartbeat({**beat, "custom_mode": 50593792}))
    copter = PROFILES["ardupilot"]
    assert copter.mode_of(heartbeat({**beat, "autopilot": 3, "custom_mode": 4})) == "GUIDED"
    assert copter.mode_of(heartbeat({**beat, "autopilot": 3, "custom_mode": 99})) == "mode 99"


def test_set_mode_is_what_the_recordings_show_to_work() -> None:
    """DO_SET_MODE as sent to, and obeyed by, the real ones: OFFBOARD (1, 6, 0), HOLD (1, 4, 3), GUIDED (1, 4, 0)."""
    px4, copter = PROFILES["px4"], PROFILES["ardupilot"]
    assert px4.set_mode_parameters("OFFBOARD") == (1, 6, 0, 0, 0, 0, 0)
    assert px4.set_mode_parameters(px4.hold_mode) == (1, 4, 3, 0, 0, 0, 0)
    assert px4.set_mode_parameters(px4.land_mode) == (1, 4, 6, 0, 0, 0, 0)
    assert px4.set_mode_parameters(px4.return_mode) == (1, 4, 5, 0, 0, 0, 0)
    assert copter.set_mode_parameters("GUIDED") == (1, 4, 0, 0, 0, 0, 0)
    # BRAKE: without a pilot's radio LOITER sank.
    assert copter.set_mode_parameters(copter.hold_mode) == (1, 17, 0, 0, 0, 0, 0)
    with pytest.raises(KeyError):
        px4.set_mode_parameters("GUIDED")
    sent = {
        (m["fields"]["param1"], m["fields"]["param2"], m["fields"]["param3"])
        for m in load("px4-nominal")[1]
        if m["dir"] == "tx" and m["msg"] == "COMMAND_LONG" and m["fields"]["command"] == 176
    }
    assert {px4.set_mode_parameters(mode)[:3] for mode in ("OFFBOARD", "HOLD", "LAND")} == sent


def test_heartbeats_of_others_are_not_the_autopilot() -> None:
    """A gimbal of the vehicle, a ground station with the vehicle's own id, and a message of another kind."""
    base = {"type": 2, "autopilot": 3, "base_mode": 81, "custom_mode": 4, "system_status": 4, "mavlink_version": 3}
    profile = PROFILES["ardupilot"]
    assert is_autopilot(profile, heartbeat(base))
    assert not is_autopilot(profile, heartbeat(base, component=154))
    assert not is_autopilot(profile, heartbeat({**base, "type": 6}))
    assert not is_autopilot(profile, heartbeat({**base, "autopilot": 8}))
    assert not is_autopilot(profile, over_the_wire(PROFILES["px4"].encode(GOOD, target_system=1)))


# ---------------------------------------------------------------- parameters


@pytest.mark.parametrize(("recording", "name"), [("px4-nominal", "px4"), ("ardupilot-nominal", "ardupilot")])
def test_parameters_read_by_real_vehicles_are_known_by_the_same_names(recording: str, name: str) -> None:
    """What the recorded vehicles told that a preflight reads, it reads under that name."""
    known = load(recording)[0]["parameters"]
    names = {one for parameter in PROFILES[name].parameters for one in parameter.names}
    read = {one for one in known if one in names}
    assert len(read) >= 10
    assert all(len(one) <= 16 for one in names)


def test_a_value_is_measured_in_one_unit_whatever_it_is_called() -> None:
    copter = PROFILES["ardupilot"]
    for name, value, metres in (("RTL_ALT", 1500, 15.0), ("RTL_ALT_M", 15.0, 15.0)):
        assert copter.measure({"return_altitude": Parameter(name, value, 9)}, "return_altitude") == metres
    assert copter.measure({"max_tilt": Parameter("ANGLE_MAX", 4500, 4)}, "max_tilt") == 45.0
    assert copter.measure({"max_tilt": Parameter("ATC_ANGLE_MAX", 45.0, 9)}, "max_tilt") == 45.0
    assert copter.measure({}, "max_tilt") is None


def test_parameters_have_keys_and_old_names() -> None:
    copter = PROFILES["ardupilot"]
    assert copter.parameter("gcs_system_id").names == ("MAV_GCS_SYSID", "SYSID_MYGCS")
    assert copter.parameter("enforce_gcs").names == ("MAV_OPTIONS", "SYSID_ENFORCE")
    assert PROFILES["px4"].parameter("offboard_loss_action").integer
    for profile in PROFILES.values():
        keys = [p.key for p in profile.parameters]
        assert len(keys) == len(set(keys))
        with pytest.raises(KeyError):
            profile.parameter("no such")
