"""PX4 beyond the recordings: what a ground station has to get right."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.mavlink.parameters import bits_of_int
from tests.support.sitl.station import (
    ACCEPTED,
    ALL,
    DENIED,
    HOLD,
    LAND,
    OFFBOARD,
    POSITION,
    RTL,
    TEMPORARILY_REJECTED,
    UNSUPPORTED,
    VELOCITY,
    Rig,
    airborne,
)


def test_arming_waits_for_a_position() -> None:
    rig = Rig("px4", ready_after_s=3.0)
    station = rig.station()
    rig.run(1.0)
    assert station.arm() == [TEMPORARILY_REJECTED]
    assert station.texts() == ["Arming denied: Resolve system health failures first"]
    assert station.last["HEARTBEAT"].system_status == mavlink.MAV_STATE_UNINIT
    rig.run(3.0)
    assert station.last["HEARTBEAT"].system_status == mavlink.MAV_STATE_STANDBY
    assert station.arm() == [ACCEPTED]


def test_offboard_without_a_stream_shows_on_the_ground_and_refuses_to_arm() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(4.0)
    assert station.set_mode(OFFBOARD) == [ACCEPTED, ACCEPTED]
    rig.run(1.1)
    assert station.last["HEARTBEAT"].custom_mode >> 16 & 255 == 6
    assert station.arm() == [TEMPORARILY_REJECTED]


def test_offboard_without_a_stream_in_flight_is_acked_and_does_not_happen() -> None:
    rig, station = airborne("px4")
    station.set_mode(HOLD)
    rig.streams.clear()
    rig.run(3.0)
    assert station.set_mode(OFFBOARD) == [ACCEPTED, TEMPORARILY_REJECTED]
    rig.run(2.0)
    assert rig.mode == "HOLD"
    assert "Switching to Offboard is currently not available" in station.texts()


@pytest.mark.parametrize(("action", "mode"), [(0, "RTL"), (1, "RTL"), (2, "RTL"), (3, "RTL"), (4, "LAND"), (5, "HOLD")])
def test_stream_loss_takes_the_configured_action_and_reenters_unasked(action: int, mode: str) -> None:
    rig, station = airborne("px4", parameters=(f"COM_OBL_RC_ACT={action}",))
    stream = rig.streams[0]
    rig.streams.clear()
    rig.run(0.9)
    assert rig.mode == "OFFBOARD"
    rig.run(0.3)
    assert rig.mode == mode
    assert "Failsafe activated" in station.texts()
    rig.run(1.0)
    assert station.last["HEARTBEAT"].system_status == mavlink.MAV_STATE_CRITICAL
    rig.streams.append(stream)
    rig.run(0.2)
    assert rig.mode == "OFFBOARD"


def test_a_commanded_hold_ends_the_unasked_reentry() -> None:
    rig, station = airborne("px4", parameters=("COM_OBL_RC_ACT=5",))
    stream = rig.streams[0]
    rig.streams.clear()
    rig.run(2.0)
    assert station.set_mode(HOLD) == [ACCEPTED, ACCEPTED]
    rig.streams.append(stream)
    rig.run(5.0)
    assert rig.mode == "HOLD"
    station.set_mode(OFFBOARD)
    rig.run(0.1)
    assert rig.mode == "OFFBOARD"


@pytest.mark.parametrize(("rate_hz", "held"), [(2.0, True), (0.8, False)])
def test_two_hertz_hold_offboard_and_less_does_not(rate_hz: float, held: bool) -> None:
    rig, station = airborne("px4")
    rig.streams.clear()
    start = rig.now
    for _ in range(int(6 * rate_hz)):
        station.local((0, 0, -50))
        rig.run(1.0 / rate_hz)
    assert ("Failsafe activated" not in station.texts(start)) == held


def test_refused_setpoints_do_not_hold_offboard() -> None:
    rig, station = airborne("px4")
    rig.streams.clear()
    station.stream(lambda now: {"position": (0, 0, -50), "frame": 2})
    rig.run(1.5)
    assert rig.mode == "RTL"
    assert "SET_POSITION_TARGET_LOCAL_NED coordinate frame 2 unsupported" in station.texts()


def test_position_alone_lags_by_speed_over_gain() -> None:
    """A target that moves at 10 m/s is followed 10 / 0.95 = 10.5 m behind, and drag adds to that through the loop."""
    rig, station = airborne("px4")
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: {"position": (10.0 * (now - start), 0, -50)})
    rig.run(30.0)
    assert 10.0 * (rig.now - start) - rig.place[0] == pytest.approx(10.5, abs=0.8)


def test_velocity_setpoints_fly_a_velocity_and_acceleration_is_fed_forward() -> None:
    rig, station = airborne("px4")
    rig.streams.clear()
    station.stream(lambda now: {"velocity": (6.0, -3.0, 0.0), "mask": VELOCITY})
    rig.run(8.0)
    assert (rig.sim.body.vn, rig.sim.body.ve) == pytest.approx((6.0, -3.0), abs=0.2)


def test_speed_parameter_bounds_setpoints() -> None:
    """MPC_XY_VEL_MAX holds for velocity fed forward too: a faster target runs away."""
    rig, station = airborne("px4", parameters=("MPC_XY_VEL_MAX=12",))
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: {"position": (18 * (now - start), 0, -50), "velocity": (18, 0, 0), "mask": ALL})
    rig.run(20.0)
    assert rig.sim.body.speed_m_s == pytest.approx(12.0, abs=0.3)
    assert 18 * (rig.now - start) - rig.place[0] > 80.0


@pytest.mark.parametrize(
    "bad",
    [
        {"position": (math.nan, 0, -50)},
        {"position": (math.inf, 0, -50)},
        {"position": (10, 0, -50), "mask": POSITION | 1},
        {"position": (10, 0, -50), "velocity": (1, 0, 0), "mask": 0x0DC0 | 8},
    ],
)
def test_one_lost_axis_stops_the_vehicle_in_offboard(bad: dict[str, object]) -> None:
    rig, station = airborne("px4")
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: bad)
    rig.run(3.0)
    assert rig.mode == "OFFBOARD"
    assert rig.sim.body.speed_m_s < 0.3
    assert station.texts(start) == []
    assert station.last["POSITION_TARGET_LOCAL_NED"].type_mask == 7


def test_global_setpoints_are_projected_with_px4s_own_sphere() -> None:
    """0.001 degree north is 111.19 m on PX4's sphere."""
    rig, station = airborne("px4", home=(53.0, 5.0, 10.0))
    station.send(
        mavlink.MAVLink_set_position_target_global_int_message(
            0, 1, 1, 5, POSITION, 530010000, 50000000, 60.0, 0, 0, 0, 0, 0, 0, 0, 0
        )
    )
    target = rig.sim.accepted_setpoints[-1][4]["position"]
    assert target == pytest.approx((111.1949, 0.0, -50.0), abs=1e-3)


def test_relative_setpoints_move_with_the_home_altitude() -> None:
    """Frame 6 is relative to a home altitude that PX4 moves by itself: targets scatter by metres. Frame 5 does not."""
    rig, station = airborne("px4", home=(53.0, 5.0, 10.0), seed=3)
    heights: dict[int, set[float]] = {5: set(), 6: set()}
    for _ in range(20):
        rig.run(2.0)
        for frame, alt in ((5, 60.0), (6, 50.0)):
            station.send(
                mavlink.MAVLink_set_position_target_global_int_message(
                    0, 1, 1, frame, POSITION, 530000000, 50000000, alt, 0, 0, 0, 0, 0, 0, 0, 0
                )
            )
            target = rig.sim.accepted_setpoints[-1][4]["position"]
            assert isinstance(target, tuple)
            heights[frame].add(round(target[2], 3))
    assert heights[5] == {-50.0}
    assert 0.5 < max(heights[6]) - min(heights[6]) < 3.5


def test_addressing_of_commands_and_setpoints() -> None:
    rig, station = airborne("px4")
    assert station.command(12345) == [UNSUPPORTED]
    assert station.command(32100, 1, 1, 10, 255) == [UNSUPPORTED]
    for system, component in ((9, 1), (0, 1), (1, 190)):
        assert station.command(176, 1, 4, 3, system=system, component=component) == []
    assert station.command(512, 242, component=0) == [ACCEPTED]
    rig.streams.clear()
    count = len(rig.sim.accepted_setpoints)
    station.local((0, 0, -50), system=9)
    station.local((0, 0, -50), component=190)
    assert len(rig.sim.accepted_setpoints) == count
    station.local((0, 0, -50), system=0, component=0)
    assert len(rig.sim.accepted_setpoints) == count + 1


def test_requested_message_comes_before_its_acknowledgement() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(3.0)
    before = len(station.heard)
    assert station.command(512, 148) == [ACCEPTED]
    assert [m.get_type() for _, m in station.heard[before:]] == ["AUTOPILOT_VERSION", "COMMAND_ACK"]
    assert station.command(512, 512) == [DENIED]


def test_heartbeat_stays_at_one_hertz_through_mode_changes() -> None:
    rig, station = airborne("px4")
    start = rig.now
    station.set_mode(HOLD)
    rig.run(0.3)
    station.set_mode(OFFBOARD)
    rig.run(9.7)
    assert len(station.of("HEARTBEAT", start)) in (10, 11)


def test_gcs_loss_matters_only_when_told_to() -> None:
    for action, mode in ((0, "OFFBOARD"), (2, "RTL")):
        rig, _ = airborne("px4", parameters=(f"NAV_DLL_ACT={action}",))
        rig.beating = False
        rig.run(12.0)
        assert rig.mode == mode


def test_land_command_lands_disarms_and_shows_the_mode_of_before() -> None:
    rig, station = airborne("px4", height_m=20.0)
    assert station.set_mode(LAND) == [ACCEPTED, ACCEPTED]
    rig.until(lambda: not rig.sim.autopilot.armed, 60.0)
    assert station.texts()[-2:] == ["Landing detected", "Disarmed by landing"]
    assert rig.mode == "OFFBOARD"
    assert rig.sim.body.on_ground


def test_return_flies_home_and_lands_there() -> None:
    rig, station = airborne("px4")
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: {"position": (min(400.0, 15 * (now - start)), 0, -50), "velocity": (15, 0, 0)})
    rig.run(20.0)
    rig.streams.clear()
    station.set_mode(RTL)
    rig.until(lambda: not rig.sim.autopilot.armed, 200.0)
    assert rig.off(0.0, 0.0) < 1.0


def test_return_goes_to_the_nearest_rally_point() -> None:
    rig, station = airborne("px4")
    lat, lon = rig.sim.body.lat_deg, rig.sim.body.lon_deg
    station.send(mavlink.MAVLink_mission_count_message(1, 1, 1, 2))
    station.send(
        mavlink.MAVLink_mission_item_int_message(
            1, 1, 0, 3, 5100, 0, 1, 0, 0, 0, 0, int((lat + 0.0018) * 1e7), int(lon * 1e7), 30.0, 2
        )
    )
    assert station.last["MISSION_ACK"].type == 0
    rig.streams.clear()
    start = rig.now
    station.stream(lambda now: {"position": (min(300.0, 15 * (now - start)), 0, -50)})
    rig.run(25.0)
    station.set_mode(RTL)
    rig.streams.clear()
    rig.until(lambda: not rig.sim.autopilot.armed, 200.0)
    assert rig.off(200.15, 0.0) < 1.5


def test_low_battery_returns_when_told_to() -> None:
    rig, station = airborne("px4", parameters=("COM_LOW_BAT_ACT=3",), faults=("battery-critical:0.06@A40",))
    rig.until(lambda: rig.mode == "RTL", 30.0)
    assert "Low battery level! Return advised" in station.texts()


def test_parameters_are_typed_and_values_are_not_checked() -> None:
    rig = Rig("px4", links=2)
    a, b = rig.station(), rig.station(link=1, system_id=254)
    rig.run(3.0)
    assert a.set_parameter("COM_OBL_RC_ACT", bits_of_int(5), 6).param_value == bits_of_int(5)
    assert a.set_parameter("COM_OBL_RC_ACT", 3.0, 9) is None
    assert a.set_parameter("COM_OF_LOSS_T", bits_of_int(2), 6) is None
    assert a.set_parameter("NO_SUCH", 1.0) is None
    assert a.set_parameter("COM_OF_LOSS_T", 1000.0).param_value == 1000.0
    assert math.isnan(a.set_parameter("COM_OF_LOSS_T", math.nan).param_value)
    rig.run(0.1)
    told = [m.param_id for m in b.of("PARAM_VALUE")]
    assert told.count("COM_OBL_RC_ACT") == 1  # by broadcast
    assert a.read_parameter("COM_FLTMODE1").param_value != a.read_parameter("COM_FLTMODE1").param_value  # bits of -1


def test_arming_without_take_off_is_undone() -> None:
    rig = Rig("px4")
    station = rig.station()
    rig.run(4.0)
    station.arm()
    rig.run(10.2)
    assert not rig.sim.autopilot.armed
    assert station.texts()[-1] == "Disarmed by auto preflight disarming"
