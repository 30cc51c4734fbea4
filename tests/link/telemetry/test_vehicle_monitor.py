"""What the vehicle says over several links at once: in order, once each, and nobody else's words."""

from __future__ import annotations

import math
from typing import Any

import pytest

from link.dialect import mavlink
from link.monitors.uplink import FOREIGN_TARGET_M
from link.telemetry.setpoint_echo import EchoTracker, Sent
from link.telemetry.vehicle_monitor import VehicleMonitor
from link.wire.codec import StationCodec


class Bench:
    """A monitor of two stations, and senders to feed it with."""

    def __init__(self) -> None:
        self.monitor = VehicleMonitor(("a", "b"), 1, frozenset({241, 242, 1}))

    def say(self, now_s: float, message: Any, link: str = "a", source: tuple[int, int] = (1, 1)) -> bool:
        (heard,) = StationCodec(99).decode(StationCodec(*source).encode(message))
        return self.monitor.receive(now_s, link, heard)


def beat(custom_mode: int = 4, *, armed: bool = True, kind: int = 2) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, 3, 128 if armed else 0, custom_mode, 4, 3)


def place(boot_ms: int, lat_e7: int = 529_500_000) -> Any:
    return mavlink.MAVLink_global_position_int_message(boot_ms, lat_e7, 47_900_000, 60_000, 20_000, 300, -400, 0, 0)


def test_only_the_autopilots_own_component_is_believed() -> None:
    bench = Bench()
    assert bench.say(1.0, beat(4))
    # A gimbal, and another vehicle, in another mode.
    assert not bench.say(1.1, beat(6, armed=False), source=(1, 154))
    assert not bench.say(1.2, beat(6, armed=False), source=(7, 1))
    assert bench.monitor.heartbeat is not None
    assert (bench.monitor.heartbeat.custom_mode, bench.monitor.heartbeat.armed) == (4, True)


def test_a_strange_ground_station_is_noticed_and_ours_are_not() -> None:
    bench = Bench()
    bench.say(3.0, beat(0, kind=6), source=(255, 190))
    bench.say(3.0, beat(0, kind=6), source=(242, 190))
    assert bench.monitor.foreign_stations == {255: 3.0}


def test_late_and_repeated_positions_do_not_move_the_vehicle_back() -> None:
    bench = Bench()
    bench.say(10.0, place(5000, 529_500_100))
    bench.say(10.05, place(4900, 529_500_000), link="b")
    bench.say(10.10, place(5000, 529_599_999), link="b")
    position = bench.monitor.position
    assert position is not None
    assert position.lat_deg == pytest.approx(52.95001)
    assert position.speed_m_s == pytest.approx(5.0)  # 3 m/s north, 4 m/s west
    assert bench.monitor.links["b"].heard_s == 10.10


def test_our_time_at_the_vehicles_is_told_by_its_fastest_message() -> None:
    bench = Bench()
    # Clock 100 s ahead of the vehicle's, delays of 30, 10 and 80 ms.
    for k, delay in enumerate((0.03, 0.01, 0.08)):
        bench.say(101.0 + k + delay, place(1000 * (k + 1)))
    assert bench.monitor.our_time_s(3.0) == pytest.approx(103.01)


def test_a_restart_is_told_from_reordering() -> None:
    bench = Bench()
    bench.say(100.0, place(90_000))
    bench.say(100.1, place(89_900))  # late
    assert bench.monitor.reboots == 0
    for k in range(3):
        bench.say(101.2 + 0.1 * k, mavlink.MAVLink_attitude_message(500 + 100 * k, 0, 0, 0, 0, 0, 0))
    assert bench.monitor.reboots == 1, "after a silence of everything"
    assert bench.monitor.position is None
    bench.say(102.2, place(1500))
    assert bench.monitor.position is not None


def test_a_probe_proves_the_link_it_came_back_over_from_when_it_was_sent() -> None:
    bench = Bench()
    probe, other = bench.monitor.probe(5.0, "a"), bench.monitor.probe(5.0, "b")
    assert probe.ts1 != other.ts1
    bench.say(5.2, mavlink.MAVLink_timesync_message(123, 999), link="a")  # nobody's
    assert not bench.monitor.proven_within(5.3, "a", 10.0)
    bench.say(5.25, mavlink.MAVLink_timesync_message(123, probe.ts1), link="b")  # over the wrong link
    assert not bench.monitor.proven_within(5.3, "a", 10.0)
    bench.say(5.3, mavlink.MAVLink_timesync_message(123, probe.ts1), link="a")
    link = bench.monitor.links["a"]
    assert link.proven_s == 5.0
    assert link.round_trip_s == pytest.approx(0.3)
    # A request of the vehicle's own is no answer.
    bench.say(9.0, mavlink.MAVLink_timesync_message(0, other.ts1), link="b")
    assert math.isinf(bench.monitor.links["b"].proven_s)


def test_a_text_that_lost_a_chunk_or_fills_its_chunks_is_shown_after_a_second() -> None:
    bench = Bench()

    def chunk(words: str, number: int, part: int) -> Any:
        return mavlink.MAVLink_statustext_message(4, words.encode(), number, part)

    # Just a hundred characters: no shorter part says that it is over.
    bench.say(1.0, chunk("a" * 50, 1, 0))
    bench.say(1.0, chunk("b" * 50, 1, 1))
    # The middle one of three is lost.
    bench.say(1.2, chunk("c" * 50, 2, 0))
    bench.say(1.2, chunk("end", 2, 2))
    assert bench.monitor.take_texts(1.9) == []
    assert bench.monitor.take_texts(2.05) == [(4, "a" * 50 + "b" * 50)]
    assert bench.monitor.take_texts(2.25) == [(4, "c" * 50 + " ... end")]
    assert bench.monitor.take_texts(9.0) == []


def test_texts_come_once_however_many_links_bring_them_and_chunks_are_joined() -> None:
    bench = Bench()

    def text(words: str, number: int = 0, chunk: int = 0) -> Any:
        return mavlink.MAVLink_statustext_message(2, words.encode(), number, chunk)

    long = "Arming denied: Resolve system health failures first\t"
    for link, later in (("a", 0.0), ("b", 0.3)):
        bench.say(1.0 + later, text("GCS Failsafe"), link=link)
        bench.say(1.1 + later, text(long[:50], 7, 0), link=link)
        bench.say(1.1 + later, text(long[50:], 7, 1), link=link)
    assert bench.monitor.take_texts() == [(2, "GCS Failsafe"), (2, long.strip())]
    assert bench.monitor.take_texts() == []
    bench.say(10.0, text("GCS Failsafe"))
    assert bench.monitor.take_texts() == [(2, "GCS Failsafe")]


def test_control_status_and_the_ekf_origin_are_kept_by_link() -> None:
    bench = Bench()
    bench.say(1.0, mavlink.MAVLink_control_status_message(1, 242, [0] * 10))
    bench.say(2.0, mavlink.MAVLink_gps_global_origin_message(529_500_000, 47_900_000, 30_000, 0), link="b")
    assert (bench.monitor.control_main, bench.monitor.control_s) == (242, 1.0)
    assert bench.monitor.links["a"].origin is None
    origin = bench.monitor.links["b"].origin
    assert origin is not None
    assert origin.alt_amsl_m == 30.0


def sent(time_s: float, east_m: float, station: str, grant: int, accel: float = 0.5, speed: float = 15.0) -> Sent:
    return Sent(time_s, station, grant, (0.0, east_m, -40.0), (0.0, speed, 0.0), (accel, 0.0, 0.0))


def target(east_m: float, accel: float = 0.5) -> Any:
    return mavlink.MAVLink_position_target_local_ned_message(
        0, 1, 0x0C00, 0, east_m, -40.0, 0, 15, 0, accel, 0, 0, 0, 0
    )


def test_the_position_px4_repeats_tells_which_setpoint_it_holds() -> None:
    echoes = EchoTracker(runs_on=False)
    for k in range(10):
        echoes.note(sent(0.05 * k, 0.75 * k, "a" if k < 5 else "b", 1 if k < 5 else 2))
    assert [s.station_id for s in echoes.held(target(0.75 * 7 + 0.01))] == ["b"]
    assert [s.station_id for s in echoes.held(target(0.75 * 4))] == ["a"]
    assert echoes.held(target(99.0)) == ()


def test_hovering_setpoints_cannot_be_told_apart() -> None:
    echoes = EchoTracker(runs_on=False)
    echoes.note(sent(0.0, 5.0, "a", 1))
    echoes.note(sent(0.1, 5.0, "b", 2))
    assert {s.grant for s in echoes.held(target(5.0))} == {1, 2}


def test_ardupilots_target_runs_on_so_its_acceleration_must_tell() -> None:
    echoes = EchoTracker(runs_on=True)
    echoes.note(sent(0.00, 0.00, "a", 1, accel=0.50))
    echoes.note(sent(0.05, 0.75, "b", 2, accel=0.53))
    # The target has moved on to where b's setpoint is, but it is a's still.
    assert [s.station_id for s in echoes.held(target(0.75, accel=0.50))] == ["a"]
    assert [s.station_id for s in echoes.held(target(0.80, accel=0.53))] == ["b"]
    # Straight and steady: every setpoint looks alike, so none is named.
    echoes.note(sent(0.10, 1.5, "b", 2, accel=0.0))
    assert echoes.held(target(1.5, accel=0.0)) == ()


def test_a_target_that_ran_on_for_seconds_proves_nothing_and_is_no_strangers() -> None:
    """Our setpoints are lost from 0 s on; the vehicle goes on at 15 m/s while we brake at 1.4 m/s^2."""
    echoes = EchoTracker(runs_on=True)
    echoes.note(sent(0.0, 0.0, "a", 1, accel=0.5))
    for k in range(1, 57):
        t = 0.05 * k
        echoes.note(sent(t, 15.0 * t - 0.7 * t * t, "a", 1, accel=-1.4, speed=15.0 - 1.4 * t))
        ran_on = target(15.0 * t, accel=0.5)
        # The one it holds, while that is fresh; never one that was lost.
        assert [s.sent_s for s in echoes.held(ran_on)] == ([0.0] if t <= 0.5 else [])
        assert echoes.distance_m(ran_on) <= FOREIGN_TARGET_M
    assert echoes.distance_m(target(15.0 * 2.8 + 20.0)) > FOREIGN_TARGET_M
