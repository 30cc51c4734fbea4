"""Somebody else's setpoints between ours: seen in every phase, and nothing seen where there are none."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from gcs.flight import FlightState
from link.dialect import mavlink
from link.monitors.uplink import FOREIGN_TARGET_M, GRACE_S, UplinkMonitor
from link.telemetry.setpoint_echo import EchoTracker, Sent
from link.telemetry.streams import STREAMED_MESSAGES

ECHO_MS = round(1e3 / dict(STREAMED_MESSAGES)[mavlink.MAVLINK_MSG_ID_POSITION_TARGET_LOCAL_NED])
SPEED_M_S = 15.0


class Sky:
    """A vehicle that obeys whoever sent last (PX4), by the millisecond. We fly north, somebody else wants it east."""

    def __init__(self, state: FlightState = FlightState.CRUISE) -> None:
        self.alarms: list[tuple[float, str]] = []
        self.c = SimpleNamespace(
            now_s=0.0,
            state=state,
            in_force=SimpleNamespace(station_id="s1"),
            echoes=EchoTracker(runs_on=False),
            monitor=SimpleNamespace(target=None, target_s=-math.inf, links={"s1": SimpleNamespace(proven_s=-math.inf)}),
            alarm=lambda what, **_: self.alarms.append((self.c.now_s, what)),
        )
        parts: Any = self.c
        self.uplink = UplinkMonitor(parts, parts, parts)
        self.uplink.restart()

    def fly(
        self, until_s: float, *, ours_ms: int, echo_at_ms: int, foreign: range = range(0), off_m: float = 60.0
    ) -> None:
        """On until a time, or the first alarm. ``foreign`` are the milliseconds somebody else's setpoint comes at."""
        held = (0.0, 0.0, 0.0)
        for ms in range(round(1e3 * self.c.now_s), round(1e3 * until_s)):
            self.c.now_s = 1e-3 * ms
            if ms % ours_ms == 0:
                held = (SPEED_M_S * self.c.now_s, 0.0, -40.0)
                self.c.echoes.note(Sent(self.c.now_s, "s1", 1, held, (SPEED_M_S, 0.0, 0.0), (0.0, 0.0, 0.0)))
            if ms in foreign:
                held = (held[0], off_m, held[2])
            if ms % ECHO_MS == echo_at_ms:
                self.c.monitor.target = mavlink.MAVLink_position_target_local_ned_message(
                    ms, 1, 0, *held, 0, 0, 0, 0, 0, 0, 0, 0
                )
                self.c.monitor.target_s = self.c.now_s
                self.uplink.update()
            if self.alarms:
                return


def noticed_s(ours_ms: int, theirs_ms: int, phase_ms: int, echo_at_ms: int) -> float:
    """How long after the foreign station's first setpoint it is told; they come ``phase_ms`` after one of ours."""
    sky = Sky()
    first = round(1e3 * GRACE_S) + 2 * ours_ms + phase_ms
    sky.fly(GRACE_S + 10.0, ours_ms=ours_ms, echo_at_ms=echo_at_ms, foreign=range(first, 10**6, theirs_ms))
    return sky.alarms[0][0] - 1e-3 * first if sky.alarms else math.inf


@pytest.mark.parametrize(("ours_hz", "theirs_hz"), [(20, 20), (20, 10), (50, 50), (50, 25), (10, 10)])
def test_a_stranger_is_told_within_a_second_in_every_phase(ours_hz: int, theirs_hz: int) -> None:
    ours_ms, theirs_ms = 1000 // ours_hz, 1000 // theirs_hz
    tried = 0
    for phase_ms in range(0, ours_ms, 1 if ours_hz > 10 else 3):
        # Its setpoint holds until our next one.
        share = (ours_ms - phase_ms) / theirs_ms
        if share < 0.125:
            continue
        for echo_at_ms in range(0, ECHO_MS, 17):
            tried += 1
            limit_s = 1.0 if share >= 0.25 else 2.0
            assert noticed_s(ours_ms, theirs_ms, phase_ms, echo_at_ms) <= limit_s, (phase_ms, echo_at_ms)
    assert tried >= 100


@pytest.mark.parametrize("phase_ms", [45, 47])
def test_one_that_holds_for_a_twentieth_of_the_time_is_told_as_the_echoes_drift(phase_ms: int) -> None:
    assert max(noticed_s(50, 50, phase_ms, echo_at_ms) for echo_at_ms in range(0, ECHO_MS, 17)) <= 10.0


@pytest.mark.parametrize("ours_hz", [10, 20, 50])
def test_our_own_setpoints_alone_are_never_strange(ours_hz: int) -> None:
    for echo_at_ms in range(0, ECHO_MS, 17):
        sky = Sky()
        sky.fly(8.0, ours_ms=1000 // ours_hz, echo_at_ms=echo_at_ms)
        assert not sky.alarms
        assert sky.uplink.foreign_for_s == 0.0


def test_a_single_strange_echo_and_one_near_ours_are_not_told() -> None:
    once, near = Sky(), Sky()
    once.fly(8.0, ours_ms=50, echo_at_ms=0, foreign=range(ECHO_MS * 30 - 1, ECHO_MS * 30))
    near.fly(8.0, ours_ms=50, echo_at_ms=0, foreign=range(2000, 10**6, 50), off_m=FOREIGN_TARGET_M - 0.5)
    assert not once.alarms
    assert not near.alarms


@pytest.mark.parametrize("state", [FlightState.LANDING, FlightState.LAPSED])
def test_a_vehicle_that_flies_its_own_target_is_no_stranger(state: FlightState) -> None:
    sky = Sky(state)
    sky.fly(6.0, ours_ms=50, echo_at_ms=0, foreign=range(2000, 10**6, 50))
    assert not sky.alarms
