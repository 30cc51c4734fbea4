"""An exception inside a tick is contained; three in a row are silence."""

from __future__ import annotations

import pytest

from gcs.flight import FlightState
from link.session.containment import FAULT
from tests.support.flights.tampered import in_the_air, ready

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])


@BOTH
@pytest.mark.parametrize("row", [1, 2])
def test_an_exception_in_a_tick_or_two_holds_them_and_is_told(autopilot: str, row: int) -> None:
    one = in_the_air(autopilot)
    air, whole = one.core.airborne, one.core.airborne.tick
    left = [row]

    def failing(dt_s: float) -> None:
        if left[0]:
            left[0] -= 1
            raise ZeroDivisionError("a fault")
        whole(dt_s)

    air.tick = failing  # type: ignore[method-assign]
    before = len(one.accepted)
    one.run_for(0.5)
    assert one.alarms(FAULT)
    assert len(one.accepted) - before >= 8
    one.run(limit_s=200.0)
    assert one.core.state is FlightState.COMPLETED


@BOTH
def test_three_exceptions_in_a_row_are_silence(autopilot: str) -> None:
    one = in_the_air(autopilot)

    def failing(dt_s: float) -> None:
        raise ZeroDivisionError("a fault")

    one.core.airborne.tick = failing  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError):
        one.run_for(1.0)


@BOTH
def test_an_exception_on_the_ground_refuses_the_flight_and_never_begins_it(autopilot: str) -> None:
    one = ready(autopilot)

    def failing() -> str:
        raise ZeroDivisionError("a fault")

    one.core.launch.evidence.void = failing  # type: ignore[method-assign]
    one.run(limit_s=60.0)
    assert one.core.state is FlightState.REFUSED
    assert one.accepted == []


@BOTH
def test_an_exception_over_a_message_is_told_and_the_flight_goes_on(autopilot: str) -> None:
    one = in_the_air(autopilot)
    monitor = one.core.context.vehicle.monitor
    whole = monitor.receive

    def failing(now_s: float, station: str, message: object, url: str | None = None) -> bool:
        if message.get_type() == "EXTENDED_SYS_STATE":  # type: ignore[attr-defined]
            raise ValueError("a fault")
        return whole(now_s, station, message, url)

    monitor.receive = failing  # type: ignore[method-assign]
    one.run_for(10.0)
    assert one.alarms(FAULT)
    assert one.core.state is FlightState.CRUISE
