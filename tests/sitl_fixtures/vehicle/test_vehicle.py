"""The whole vehicle: tracking, determinism, clocks, telemetry, the battery, frames on the wire."""

from __future__ import annotations

import math

import pytest
from geographiclib.geodesic import Geodesic
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.ardupilot.parameters import ARDUPILOT
from sitl_fixtures.dynamics.battery import Battery
from sitl_fixtures.dynamics.controller import Shaper, constrain_sum, square_root_control
from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.mavlink.parameters import INT32, REAL32, ParameterSet, bits_of_int, int_of_bits
from sitl_fixtures.mavlink.wire import PLAIN, Packer, Port
from sitl_fixtures.px4.parameters import PX4
from sitl_fixtures.vehicle import SimulatedAutopilot, SimulatorConfig
from tests.support.sitl.station import ALL, POSITION_VELOCITY, Rig, airborne


def s_curve(speed: float, lateral_m_s2: float, now: float) -> tuple[float, ...]:
    """A run north with a sideways sine: position, velocity, acceleration (north, east) at a time; starts at rest."""
    ramp = speed / 2.5
    if now < ramp:
        n, vn, an = 0.5 * speed / ramp * now * now, speed / ramp * now, speed / ramp
    else:
        n, vn, an = 0.5 * speed * ramp + speed * (now - ramp), speed, 0.0
    omega = 0.2
    amplitude = lateral_m_s2 / omega**2
    phase = omega * max(0.0, now - ramp)
    # 1 - cos starts with no sideways speed; the step in acceleration is what the vehicle has to swallow.
    return (
        n,
        amplitude * (1 - math.cos(phase)),
        vn,
        amplitude * omega * math.sin(phase),
        an,
        (amplitude * omega**2 * math.cos(phase) if now >= ramp else 0.0),
    )


def tracking(
    autopilot: str, speed: float, lateral: float, mask: int = ALL, seconds: float = 90.0
) -> tuple[float, float]:
    """rms and largest distance from a streamed curve, m, 20 Hz."""
    rig, station = airborne(autopilot)
    rig.streams.clear()
    start = rig.now

    def target(now: float) -> dict[str, object]:
        n, e, vn, ve, an, ae = s_curve(speed, lateral, now - start)
        return {"position": (n, e, -50.0), "velocity": (vn, ve, 0.0), "accel": (an, ae, 0.0), "mask": mask}

    station.stream(target)
    errors = []
    while rig.now < start + seconds:
        rig.run(0.05)
        n, e, *_ = s_curve(speed, lateral, rig.now - start)
        errors.append(math.dist(rig.place, (n, e, -50.0)))
    return math.sqrt(sum(e * e for e in errors) / len(errors)), max(errors)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("autopilot", "speed", "lateral", "rms_m", "worst_m"),
    [
        ("ardupilot", 18.0, 2.0, 0.6, 1.3),
        ("px4", 14.0, 2.0, 1.1, 1.8),
        ("ardupilot", 30.0, 2.5, 0.9, 1.6),
        ("px4", 30.0, 2.5, 1.1, 2.0),
        ("ardupilot", 50.0, 5.0, 1.6, 3.0),
        ("px4", 50.0, 5.0, 1.6, 3.5),
    ],
)
def test_the_default_vehicle_follows_fast_missions(
    autopilot: str, speed: float, lateral: float, rms_m: float, worst_m: float
) -> None:
    """As well as the real ones did at 14 and 18 m/s; and at 30 and 50 m/s, which they were not asked for."""
    rms, worst = tracking(autopilot, speed, lateral)
    assert 0.05 < rms <= rms_m
    assert worst <= worst_m


def test_acceleration_fed_forward_helps() -> None:
    with_it, _ = tracking("px4", 15.0, 2.0)
    without, _ = tracking("px4", 15.0, 2.0, mask=POSITION_VELOCITY)
    assert with_it < 0.8 * without


def test_top_speed_option_is_the_speed_it_tops_out_at() -> None:
    rig, station = airborne("px4", max_speed_m_s=20.0)
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: {"position": (30 * (now - start), 0, -50), "velocity": (30, 0, 0), "mask": ALL})
    rig.run(40.0)
    assert rig.sim.body.speed_m_s == pytest.approx(20.0, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_true_place_is_where_the_autopilots_own_numbers_say(autopilot: str) -> None:
    """At (3000, 4000) in its local frame the vehicle is 5 km from home, less the fault of its projection (< 0.4 %), and
    GLOBAL_POSITION_INT tells the true place to 2 cm."""
    rig, station = airborne(autopilot, home=(53.0, 5.0, 0.0))
    rig.streams.clear()
    station.stream(lambda now: {"position": (3000, 4000, -50)})
    rig.until(lambda: rig.off(3000, 4000) < 0.1, 600.0)
    rig.run(10.0)
    body, told = rig.sim.body, station.last["GLOBAL_POSITION_INT"]
    line = Geodesic.WGS84.Inverse(53.0, 5.0, body.lat_deg, body.lon_deg)
    assert line["s12"] == pytest.approx(5000.0, rel=0.004)
    assert abs(line["s12"] - 5000.0) > 3.0
    assert Geodesic.WGS84.Inverse(told.lat / 1e7, told.lon / 1e7, body.lat_deg, body.lon_deg)["s12"] < 0.02
    assert told.relative_alt == pytest.approx(50_000, abs=1600)


def test_runs_are_the_same_to_the_byte() -> None:
    runs = []
    for _ in range(2):
        rig, station = airborne("px4", seed=5)
        station.set_mode((4, 5))
        rig.run(20.0)
        runs.append(rig.frames)
    assert runs[0] == runs[1]


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(0.001, 0.7), min_size=20, max_size=60))
def test_how_often_it_is_stepped_does_not_matter(steps: list[float]) -> None:
    """The same ticks are run whether the caller comes often or seldom."""
    fine, coarse = (SimulatedAutopilot(SimulatorConfig("ardupilot")) for _ in range(2))
    now = 0.0
    for step in steps:
        now += step
        fine.step(now)
    total = now
    coarse.step(0.0 + steps[0])
    coarse.step(total)
    assert fine.time_s == pytest.approx(coarse.time_s, abs=fine.config.tick_s * 1.01)
    fine_frames = [frame for _, frame in fine.take_outgoing()]
    coarse_frames = [frame for _, frame in coarse.take_outgoing()]
    shared = min(len(fine_frames), len(coarse_frames))
    assert fine_frames[:shared] == coarse_frames[:shared]


def test_next_event_is_never_past_what_is_due() -> None:
    """A caller that sleeps until ``next_event_s`` misses nothing: every second has its heartbeat."""
    sim = SimulatedAutopilot(SimulatorConfig("px4"))
    sim.step(100.0)
    now, beats = 100.0, 0
    while now < 130.0:
        assert sim.next_event_s() > now
        now = sim.next_event_s()
        sim.step(now)
        beats += sum(frame[7:10] == b"\0\0\0" for _, frame in sim.take_outgoing())
    assert beats == pytest.approx(30, abs=1)


def test_rates_are_the_vehicles_and_can_be_set_link_by_link() -> None:
    rig = Rig("px4", links=2)
    a, b = rig.station(0), rig.station(1, 254)
    rig.run(5.0)
    assert a.command(511, mavlink.MAVLINK_MSG_ID_ATTITUDE, 100_000.0) == [0]
    assert a.command(511, mavlink.MAVLINK_MSG_ID_VFR_HUD, -1.0) == [0]
    start = rig.now + 0.01
    rig.run(10.0)
    assert len(a.of("ATTITUDE", start)) == pytest.approx(100, abs=1)
    assert len(b.of("ATTITUDE", start)) == pytest.approx(20, abs=1)
    assert not a.of("VFR_HUD", start)
    assert b.of("VFR_HUD", start)
    assert a.command(511, mavlink.MAVLINK_MSG_ID_VFR_HUD, 0.0) == [0]
    assert a.command(510, mavlink.MAVLINK_MSG_ID_VFR_HUD) == [0]
    assert a.last["MESSAGE_INTERVAL"].interval_us == 1_000_000


def test_data_streams_of_old() -> None:
    rig = Rig("ardupilot")
    station = rig.station()
    rig.run(4.0)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_POSITION, 10, 1))
    start = rig.now + 0.01
    rig.run(5.0)
    assert len(station.of("GLOBAL_POSITION_INT", start)) == pytest.approx(50, abs=1)
    station.send(mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_POSITION, 10, 0))
    start = rig.now + 0.01
    rig.run(3.0)
    assert not station.of("GLOBAL_POSITION_INT", start)


def test_each_link_counts_its_own_sequence() -> None:
    rig = Rig("px4", links=3)
    rig.station(0)
    rig.run(20.0)
    for link in range(3):
        sequence = [frame[4] for _, at, frame in rig.frames if at == link]
        assert sequence == [n % 256 for n in range(len(sequence))]


def test_timesync_and_ping_are_answered_on_their_link_alone() -> None:
    rig = Rig("px4", links=2)
    a, b = rig.station(0), rig.station(1, 254)
    rig.run(3.0)
    a.send(mavlink.MAVLink_timesync_message(0, 123_456))
    a.send(mavlink.MAVLink_ping_message(5, 6, 0, 0))
    assert a.last["TIMESYNC"].ts1 == 123_456
    assert a.last["TIMESYNC"].tc1 == pytest.approx(rig.sim.time_s * 1e9, rel=1e-6)
    assert (a.last["PING"].seq, a.last["PING"].target_system) == (6, 255)
    assert "TIMESYNC" not in b.last


def test_reboot_command_starts_the_clock_anew_and_keeps_parameters() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(20.0)
    station.set_parameter("COM_OF_LOSS_T", 1.5)
    assert station.command(246, 1) == [0]
    rig.run(4.0)
    assert station.last["SYSTEM_TIME"].time_boot_ms < 4500
    assert station.read_parameter("COM_OF_LOSS_T").param_value == 1.5


def test_parameter_listing_is_whole() -> None:
    rig = Rig("ardupilot")
    station = rig.station()
    rig.run(2.0)
    station.send(mavlink.MAVLink_param_request_list_message(1, 1))
    rig.run(4.0)
    seen = {m.param_index: m.param_id for m in station.of("PARAM_VALUE") if m.param_index != 65535}
    assert sorted(seen) == list(range(len(ARDUPILOT)))
    assert set(seen.values()) == {name for name, *_ in ARDUPILOT}


@pytest.mark.parametrize("table", [ARDUPILOT, PX4])
def test_parameter_tables_are_well_formed(table: list[tuple[str, float, int]]) -> None:
    names = [name for name, *_ in table]
    assert len(names) == len(set(names))
    assert all(len(name) <= 16 for name in names)
    required = {"SIM_SPEEDUP"}
    required |= (
        {"MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS", "GUID_TIMEOUT", "FS_GCS_ENABLE", "FS_GCS_TIMEOUT"}
        if table is ARDUPILOT
        else {"COM_OF_LOSS_T", "COM_OBL_RC_ACT", "NAV_DLL_ACT", "COM_DL_LOSS_T", "COM_RCL_EXCEPT", "RTL_TYPE"}
    )
    assert required <= set(names)


@given(st.integers(-(2**31), 2**31 - 1))
def test_integers_travel_as_bits(value: int) -> None:
    parameters = ParameterSet([("N", 0, INT32), ("F", 0.0, REAL32)], bitwise=True)
    wire = bits_of_int(value)
    if wire == wire:  # a NaN need not keep its bits through a float
        assert int_of_bits(wire) == value
    taken = parameters.set_from_wire("N", wire, INT32)
    assert taken is not None
    assert parameters.set_from_wire("F", wire, INT32) is None


def test_ardupilot_clips_and_rounds_to_the_stored_type() -> None:
    parameters = ParameterSet([("B", 0, 2), ("H", 0, 4)], bitwise=False)
    assert parameters.set_from_wire("B", 300.0, 9).value == 127  # type: ignore[union-attr]
    assert parameters.set_from_wire("H", 3.6, 9).value == 4  # type: ignore[union-attr]
    assert parameters.set_from_wire("H", math.nan, 9) is None


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=400))
def test_no_bytes_upset_it(data: bytes) -> None:
    port = Port(0)
    port.parse(data)
    message = port.parse(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 255, 190)))
    assert len(message) <= 2


@pytest.mark.parametrize("signed", [False, True])
def test_the_quick_way_and_pymavlinks_give_the_same_frames_and_messages(signed: bool) -> None:
    """Every plain message of the dialect, packed and parsed both ways."""
    stock, packer = mavlink.MAVLink(None, 1, 1), Packer(1, 1)
    if signed:
        stock.signing.secret_key, stock.signing.sign_outgoing = b"k" * 32, True
    assert len(PLAIN) > 150
    for kind in PLAIN.values():
        message = kind(*[1.5 if "float" in t or "double" in t else 7 for t in kind.fieldtypes])
        theirs = message.pack(stock)
        ours = Port(0).frame(packer.pack(message), kind.crc_extra)
        if not signed:
            assert ours == theirs, kind.msgname
        parsed = Port(0).parse(theirs)
        assert len(parsed) == 1
        assert parsed[0].to_dict() == message.to_dict()
        assert bytes(parsed[0].get_msgbuf()) == theirs
        assert parsed[0].get_srcSystem() == 1


def test_battery_adds_up() -> None:
    """One hour at 10 A out of 20 Ah is half of it; the voltage falls with charge and load."""
    battery = Battery(capacity_mah=20_000.0, hover_a=10.0)
    full = battery.voltage_v
    for _ in range(36_000):
        battery.step(0.1, True, 9.80665, 0.0)
    assert battery.current_a == pytest.approx(10.0)
    assert battery.remaining == pytest.approx(0.5, abs=1e-3)
    assert battery.voltage_v < full - 1.0
    battery.step(1e6, True, 9.80665, 0.0)
    assert battery.remaining == 0.0


def test_square_root_control_by_hand() -> None:
    """Gain 2, limit 4: linear to 1 m (2 m/s), then sqrt(8 (e - 0.5)): 4.5 m gives 5.657 m/s."""
    assert square_root_control(0.5, 2.0, 4.0) == 1.0
    assert square_root_control(1.0, 2.0, 4.0) == 2.0
    assert square_root_control(4.5, 2.0, 4.0) == pytest.approx(5.65685, abs=1e-5)


@given(*[st.floats(-30, 30)] * 4, st.floats(0.5, 40))
def test_a_sum_cut_to_length_keeps_its_first_part_first(a: float, b: float, c: float, d: float, most: float) -> None:
    n, e = constrain_sum((a, b), (c, d), most)
    assert math.hypot(n, e) <= most * (1 + 1e-9)
    if math.hypot(a + c, b + d) <= most:
        assert (n, e) == (a + c, b + d)


@settings(max_examples=50, deadline=None)
@given(st.floats(-200, 200), st.floats(-200, 200), st.floats(0, 15))
def test_the_shaper_arrives_within_its_limits(north: float, east: float, speed: float) -> None:
    shaper = Shaper()
    shaper.reset((0.0, 0.0, 0.0), (speed, 0.0, 0.0))
    last = (0.0, 0.0)
    for _ in range(6000):
        shaper.horizontal(
            (north, east, 0, 0, 0, 0),
            use_position=True,
            max_correction_m_s=12.0,
            accel_m_s2=5.0,
            jerk_m_s3=20.0,
            brake_m_s2=3.0,
            dt=0.01,
        )
        assert math.hypot(shaper.an - last[0], shaper.ae - last[1]) <= 0.2 + 1e-9
        assert math.hypot(shaper.an, shaper.ae) <= 5.0 + 1e-6
        last = (shaper.an, shaper.ae)
    assert math.hypot(shaper.pn - north, shaper.pe - east) < 0.01


@pytest.mark.parametrize(
    "options",
    [
        {"home": (95.0, 5.0, 0.0)},
        {"system_id": 0},
        {"tick_s": 1.0},
        {"links": 0},
        {"speedup": math.nan},
        {"tilt_deg": 80},
    ],
)
def test_a_vehicle_that_cannot_be(options: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        SimulatorConfig(**options)  # type: ignore[arg-type]
