"""Deadlines without drift, ticks skipped and never caught up, UTC that does not jump; clocks to the last step."""

from __future__ import annotations

import math
import time
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

import link.clock
from link.clock import LATENESS_EDGES_MS, FlightClock, PacedClock, TickGrid, TickLateness, UtcScale


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


class Real:
    """A source of real seconds moved by hand."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_allowed_speed_ups_end_at_their_limits() -> None:
    for speedup in (0.1, 1000.0):
        assert FlightClock(speedup, Real()).speedup == speedup
    for speedup in (0.0999, 1000.01):
        with pytest.raises(ValueError, match=r"allowed is 0\.1 to 1000"):
            FlightClock(speedup, Real())
    assert FlightClock().speedup == 1.0


def test_the_flights_clock_counts_a_suspended_machine_too(monkeypatch: pytest.MonkeyPatch) -> None:
    boot, monotonic = [50.0], [20.0]
    monkeypatch.setattr(time, "clock_gettime", lambda clock: boot[0] if clock == link.clock._BOOTTIME else math.nan)
    monkeypatch.setattr(time, "monotonic", lambda: monotonic[0])
    clock = FlightClock(2.0)
    boot[0] += 3.0
    assert clock.now_s() == 6.0
    # Where there is no such clock, the monotonic one serves.
    monkeypatch.setattr(link.clock, "_BOOTTIME", None)
    other = FlightClock(2.0)
    monotonic[0] += 4.0
    assert other.now_s() == 8.0


# -- the paced clock --------------------------------------------------------------------------------------------------


def paced(speedup: float = 16.0) -> tuple[PacedClock, Real]:
    real = Real()
    return PacedClock(speedup, real), real


def test_it_runs_at_the_speed_up_and_slips_where_a_real_clock_would_jump() -> None:
    clock, real = paced()
    assert clock.now_s() == 0.0
    real.now += 0.0078125
    assert clock.now_s() == 0.125
    real.now += 0.015625
    assert clock.now_s() == 0.375  # 0.25 s, just what one step may be
    real.now += 10.0
    assert clock.now_s() == 0.625  # a stall costs time, and is not made up
    assert clock.now_s() == 0.625
    assert clock.wait_s(1.625) == pytest.approx(1.0 / 16.0)
    assert clock.wait_s(0.5) == 0.0


def test_it_waits_for_a_vehicle_that_was_heard_and_falls_behind() -> None:
    clock, real = paced()
    clock.now_s()
    clock.heard(None)
    seen = []
    for _ in range(10):
        real.now += 0.015625
        seen.append(clock.now_s())
    # The vehicle's clock is carried on for 0.6 s, and 0.15 s ahead of it is as far as this one goes.
    assert seen == [0.25, 0.5] + [0.75] * 8
    # Standing still it waits half a millisecond at least; a passed deadline is due once it moves again.
    real.now += 0.001
    assert clock.wait_s(0.0) == 0.0005
    real.now += 0.001
    assert clock.wait_s(16.75) == pytest.approx(1.0)


def test_silence_of_a_second_is_the_vehicles_and_it_goes_on() -> None:
    clock, real = paced()
    clock.now_s()
    clock.heard(None)
    for _ in range(62):
        real.now += 0.015625
        clock.now_s()
    assert clock.now_s() == 0.75
    real.now = 100.999
    assert clock.now_s() == 0.75
    real.now = 101.0
    assert clock.now_s() == pytest.approx(0.75 + 0.001 * 16.0)
    assert clock.wait_s(0.0) == 0.0


def test_the_vehicles_own_clock_is_compared_from_its_fastest_message_on() -> None:
    clock, real = paced()
    clock.now_s()
    for _ in range(4):
        real.now += 1.0
        clock.now_s()  # nothing heard: free, 0.25 s a look
    assert clock.now_s() == 1.0
    clock.heard(41.0)  # ours is 40 s behind
    clock.heard(41.25)  # and by this one 40.25
    clock.heard(41.0625 + 0.1875)
    assert clock._vehicle_s == 1.0
    clock.heard(41.125 + 0.25)  # 40.375 behind: the fastest so far, again "now"
    assert clock._vehicle_s == 1.0
    real.now += 0.0078125
    assert clock.now_s() == 1.125
    clock.heard(41.4375)  # a slow one: 40.3125 behind by itself, 40.375 by the fastest
    assert clock._vehicle_s == pytest.approx(1.0625)


def test_a_vehicle_that_started_anew_is_compared_anew() -> None:
    clock, real = paced()
    real.now += 0.015625
    clock.now_s()
    clock.heard(500.0)
    assert clock._vehicle_s == 0.25
    clock.heard(0.5)
    assert clock._vehicle_s == 0.25
    real.now += 0.0078125
    assert clock.now_s() == 0.375
    clock.heard(0.5)  # the same stamp is no new start
    assert clock._vehicle_s == 0.25


def test_hearing_it_again_lets_it_go_on() -> None:
    clock, real = paced()
    clock.now_s()
    clock.heard(None)
    for _ in range(8):
        real.now += 0.015625
        clock.now_s()
    assert clock.now_s() == 0.75
    clock.heard(None)
    real.now += 0.0078125
    assert clock.now_s() == 0.875


# -- the rest ---------------------------------------------------------------------------------------------------------


def test_utc_is_read_off_the_flights_clock() -> None:
    scale = UtcScale(1_795_320_000.0)
    assert scale.unix_s(12.5) == 1_795_320_012.5
    assert scale.text(12.5) == "2026-11-22T04:00:12.500Z"
    assert datetime.fromisoformat(scale.text(0.0)) == datetime(2026, 11, 22, 4, 0, tzinfo=UTC)


def test_a_tick_is_due_at_its_deadline_even_where_floats_fall_short() -> None:
    grid = TickGrid(10.0, 0.0)
    assert (grid.rate_hz, grid.period_s, grid.start_s) == (10.0, 0.1, 0.0)
    assert grid.deadline_s == 0.0
    for k in range(1000):
        tick = grid.due(grid.deadline_s)
        assert tick is not None
        assert (tick.index, tick.skipped) == (k, 0)
        assert tick.lateness_s == 0.0
    assert grid.deadline_s == 100.0


def test_a_tick_served_an_instant_before_the_next_is_not_the_next() -> None:
    grid = TickGrid(20.0, 0.0)
    tick = grid.due(0.0499)
    assert tick is not None
    assert (tick.index, tick.time_s, tick.skipped) == (0, 0.0, 0)
    assert tick.lateness_s == pytest.approx(0.0499)
    later = grid.due(0.1)
    assert later is not None
    assert (later.index, later.skipped) == (2, 1)


def test_lateness_falls_into_its_bin_edge_included() -> None:
    assert LATENESS_EDGES_MS == (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0)
    late = TickLateness()
    assert late.counts == [0] * 14
    assert (late.worst_ms, late.skipped) == (0.0, 0)
    for seconds in (0.0, 0.5e-3, 0.51e-3, 2.0):
        late.add(seconds)
    assert [k for k, n in enumerate(late.counts) if n] == [0, 2, 3, 13]
    late.add(0.001, 3)
    late.add(0.001, 2)
    assert late.skipped == 5
    assert late.worst_ms == 2000.0
    assert late.to_document()["counts_by_ms"] == {"0.1": 1, "0.5": 1, "1": 3, "more": 1}


def test_quantiles_of_nothing_of_little_and_of_the_last_bin() -> None:
    late = TickLateness()
    assert late.quantile_ms(0.5) == 0.0
    assert late.to_document() == {
        "counts_by_ms": {},
        "p50_ms": 0.0,
        "p99_ms": 0.0,
        "worst_ms": 0.0,
        "skipped_ticks": 0,
    }
    late.add(0.3e-3)
    # Never more than the worst that was seen.
    assert late.quantile_ms(0.5) == pytest.approx(0.3)
    late.add(4.0)
    assert late.quantile_ms(0.5) == 0.5
    assert late.to_document()["p50_ms"] == 0.5
    assert late.quantile_ms(0.51) == 4000.0
    assert late.quantile_ms(1.0) == 4000.0
    assert late.to_document()["p99_ms"] == 4000.0


def test_the_ninety_ninth_percentile_leaves_out_one_tick_in_a_hundred() -> None:
    late = TickLateness()
    for _ in range(990):
        late.add(0.00005)
    for _ in range(10):
        late.add(0.9)
    document = late.to_document()
    assert (document["p50_ms"], document["p99_ms"], document["worst_ms"]) == (0.1, 0.1, 900.0)
    late.add(0.9)
    assert late.to_document()["p99_ms"] == 900.0
