"""Deadlines without drift, ticks skipped and never caught up, UTC that does not jump."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from link.clock import FlightClock, TickGrid, TickLateness, UtcScale


def test_the_flight_clock_runs_at_the_speed_up_and_waits_in_real_seconds() -> None:
    real = [100.0]
    clock = FlightClock(4.0, lambda: real[0])
    assert clock.now_s() == 0.0
    real[0] = 102.5
    assert clock.now_s() == 10.0
    assert clock.wait_s(12.0) == 0.5
    assert clock.wait_s(9.0) == 0.0


@pytest.mark.parametrize("speedup", [0.0, -1.0, 1001.0, float("nan")])
def test_a_speed_up_out_of_range_is_refused(speedup: float) -> None:
    with pytest.raises(ValueError, match=r"allowed is 0\.1 to 1000"):
        FlightClock(speedup)


def test_utc_follows_the_flights_clock() -> None:
    scale = UtcScale(1_795_320_000.25)
    assert scale.text(0.0) == "2026-11-22T04:00:00.250Z"
    assert scale.text(59.751) == "2026-11-22T04:01:00.001Z"


def test_a_late_tick_is_the_newest_due_and_the_missed_ones_are_counted() -> None:
    grid = TickGrid(20.0, 5.0)
    assert grid.due(4.99) is None
    first = grid.due(5.0)
    assert first is not None
    assert (first.index, first.skipped) == (0, 0)
    assert grid.due(5.01) is None
    late = grid.due(5.21)
    assert late is not None
    assert (late.index, late.skipped) == (4, 3)
    assert late.time_s == pytest.approx(5.2)
    assert late.lateness_s == pytest.approx(0.16)  # behind the first deadline missed, 5.05
    assert grid.deadline_s == pytest.approx(5.25)


@given(st.lists(st.floats(0.0, 0.4), min_size=1, max_size=80), st.sampled_from([5.0, 20.0, 50.0, 33.3]))
def test_what_is_served_is_less_than_a_period_old_and_every_tick_is_served_or_skipped(
    waits: list[float], rate_hz: float
) -> None:
    grid, now, served, skipped = TickGrid(rate_hz, 0.0), 0.0, [], 0
    for wait in waits:
        now += wait
        tick = grid.due(now)
        if tick is not None:
            served.append(tick.index)
            skipped += tick.skipped
            assert -1e-9 <= now - tick.time_s < 1.0 / rate_hz + 1e-9
            assert grid.deadline_s > now - 1e-9
    assert served == sorted(set(served))
    if served:
        assert served[-1] + 1 == len(served) + skipped


def test_lateness_quantiles_are_upper_bounds() -> None:
    lateness = TickLateness()
    for late_ms in [0.05] * 98 + [3.0, 40.0]:
        lateness.add(late_ms * 1e-3)
    lateness.add(0.0, skipped=2)
    document = lateness.to_document()
    assert document["p50_ms"] == 0.1
    assert lateness.quantile_ms(0.985) == 5.0
    assert document["worst_ms"] == pytest.approx(40.0)
    assert document["skipped_ticks"] == 2
    assert sum(lateness.counts) == 101
