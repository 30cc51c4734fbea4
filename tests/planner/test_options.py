"""Optional limits: each kept to the letter, each costing what it must, together with overlap and tenure."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from planner import InfeasibleError, Planner, Problem, Solution, Trajectory, certify
from planner.energy import cost_s, energy_s
from tests.support.missions.problems import make_problem, paper_problem

FLYABLE = {"min_overlap_s": 5.0, "min_tenure_s": 10.0}


def planned(problem: Problem, method: Any = "joint") -> Solution:
    """A plan that keeps everything, measured afresh and at many times between the control points' bounds."""
    solution = Planner().plan(problem, method=method)
    certificate = certify(problem, solution.trajectory)
    assert certificate.feasible, certificate.worst
    assert solution.trajectory.duration_s >= solution.lower_bound_s * (1.0 - 1e-9)
    return solution


def sampled(solution: Solution, order: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    return solution.trajectory.evaluate(np.linspace(0.0, solution.trajectory.duration_s, 2001), order)


def straight(**limits: Any) -> Problem:
    """6 km along one large range, 100 m to climb, 50 m/s and 5 m/s^2: 120 + 10 s without further limits."""
    return make_problem([0, 0, 100], [6000, 0, 200], [[3000, 0, 0, 9000]], band=(100.0, 300.0), limits=limits)


@pytest.mark.parametrize("jerk", [2.0, 5.0, 20.0])
def test_jerk(jerk: float) -> None:
    """Speeding up and braking together take a/j longer at least; so does the plan, but for 3 %."""
    free = planned(straight())
    limited = planned(straight(max_jerk_m_s3=jerk))
    assert np.linalg.norm(sampled(limited, 3), axis=-1).max() <= jerk * (1 + 1e-9)
    assert np.linalg.norm(sampled(free, 3), axis=-1).max() > jerk
    assert limited.lower_bound_s == pytest.approx(free.lower_bound_s + 5.0 / jerk, abs=0.2)
    assert limited.trajectory.duration_s <= limited.lower_bound_s * 1.03


@pytest.mark.parametrize("jerk", [2.0, 5.0])
@pytest.mark.parametrize("options", [{}, {"margin_m": 25.0, **FLYABLE}])
def test_jerk_along_stations(jerk: float, options: dict[str, float]) -> None:
    problem = paper_problem("M30_03", limits={"max_jerk_m_s3": jerk}, **options)
    solution = planned(problem)
    assert solution.method == "joint"
    assert np.linalg.norm(sampled(solution, 3), axis=-1).max() <= jerk * (1 + 1e-9)


def test_climb_is_worked_off_on_the_way() -> None:
    """100 m at 2 m/s take 50 s of the 130: no slower than without. At 0.5 m/s they take 200 s, the bound."""
    easy = planned(straight(max_climb_m_s=2.0))
    assert sampled(easy, 1)[:, 2].max() <= 2.0 + 1e-9
    assert easy.trajectory.duration_s <= planned(straight()).trajectory.duration_s * 1.01
    slow = planned(straight(max_climb_m_s=0.5))
    assert slow.lower_bound_s == pytest.approx(200.0)
    assert slow.trajectory.duration_s <= 205.0


def test_descent_is_not_climb() -> None:
    down = replace(straight(max_descent_m_s=1.0), start_m=[0, 0, 200], destination_m=[6000, 0, 100])
    solution = planned(down)
    assert sampled(solution, 1)[:, 2].min() >= -1.0 - 1e-9
    # Up is not limited by it.
    assert planned(straight(max_descent_m_s=1.0)).trajectory.duration_s < 135.0


@pytest.mark.parametrize(("wind", "ground_m_s"), [((-10.0, 0.0), 20.0), ((10.0, 0.0), 40.0), ((0.0, 18.0), 24.0)])
def test_wind(wind: tuple[float, float], ground_m_s: float) -> None:
    """Airspeed 30 m/s: against 10 m/s 20 over ground, with it 40, across 18 m/s sqrt(30^2 - 18^2) = 24."""
    solution = planned(straight(max_airspeed_m_s=30.0, wind_m_s=wind))
    air = sampled(solution, 1) - np.array([*wind, 0.0])
    assert np.linalg.norm(air, axis=-1).max() <= 30.0 * (1 + 1e-9)
    expected = 6000.0 / ground_m_s + ground_m_s / 5.0
    assert solution.trajectory.duration_s == pytest.approx(expected, rel=0.03)


def test_wind_along_stations() -> None:
    limits = {"max_airspeed_m_s": 35.0, "wind_m_s": (-8.0, 12.0)}
    solution = planned(paper_problem("M30_10", limits=limits, margin_m=25.0, **FLYABLE))
    air = sampled(solution, 1) - np.array([-8.0, 12.0, 0.0])
    assert np.linalg.norm(air, axis=-1).max() <= 35.0 * (1 + 1e-9)


def test_elevation_masks() -> None:
    """Antennas on the ground, 10 degrees: at 100 m a station hears 567 m around it, at 200 m 1,134 m.

    Two stations 1,400 m apart meet only above 124 m, so the flight climbs for its handover.
    """
    stations = [[0, 0, 0, 2000], [1400, 0, 0, 2000]]
    mask = np.array([10.0, 10.0])
    problem = make_problem([0, 0, 100], [1400, 0, 100], stations, band=(100.0, 200.0), min_elevation_deg=mask)
    solution = planned(problem)
    handover = solution.trajectory.evaluate(solution.trajectory.handover_times_s)[0]
    assert handover[2] > 700.0 * np.tan(np.radians(10.0)) - 1e-6
    blind = replace(problem, limits=replace(problem.limits, max_alt_m=120.0))
    with pytest.raises(InfeasibleError) as raised:
        Planner().plan(blind)
    assert raised.value.infeasibility.reason == "broken_chain"


def test_elevation_masks_with_overlap() -> None:
    stations = [[0, 0, 0, 2000], [1400, 0, 0, 2000]]
    mask = np.array([10.0, 10.0])
    problem = make_problem(
        [0, 0, 100], [1400, 0, 100], stations, band=(100.0, 200.0), min_elevation_deg=mask, **FLYABLE
    )
    planned(problem)


def test_endurance_kept() -> None:
    solution = planned(straight(max_duration_s=140.0))
    assert solution.certificate.worst["duration_s"] < 0.0


@pytest.mark.parametrize("speed", [20.0, 50.0])
def test_moving_start(speed: float) -> None:
    """From full speed ahead there is nothing to gain: v / a less time than from rest, a quarter of it spent rolling."""
    rest = planned(straight())
    moving = planned(replace(straight(), start_velocity_m_s=np.array([speed, 0.0, 0.0])))
    assert sampled(moving, 1)[0] == pytest.approx([speed, 0.0, 0.0])
    saved = rest.trajectory.duration_s - moving.trajectory.duration_s
    # Speeding up to v takes v/a and covers v^2/2a: the head start is worth s/a - s^2/(2 a v).
    assert saved == pytest.approx(speed / 5.0 - speed**2 / (2 * 5.0 * 50.0), abs=1.0)


def test_moving_start_away_from_the_goal() -> None:
    """Flying the wrong way at 40 m/s with acceleration: turned around, in range all the time."""
    problem = replace(
        paper_problem("M30_10"),
        start_velocity_m_s=np.array([-20.0, -30.0, 0.0]),
        start_acceleration_m_s2=np.array([1.0, -1.0, 0.2]),
    )
    solution = planned(problem)
    assert sampled(solution, 2)[0] == pytest.approx([1.0, -1.0, 0.2])


def test_moving_start_with_everything() -> None:
    limits = {"max_jerk_m_s3": 5.0, "max_climb_m_s": 3.0, "max_airspeed_m_s": 45.0, "wind_m_s": (5.0, 0.0)}
    problem = paper_problem("M30_06", limits=limits, margin_m=25.0, **FLYABLE)
    planned(replace(problem, start_velocity_m_s=np.array([10.0, 5.0, 0.0])))


@pytest.mark.slow
def test_no_room_to_stop() -> None:
    """At 50 m/s, 10 m from the edge of the only range, 250 m are needed to stop."""
    problem = make_problem([984, 0, 100], [0, 0, 100], [[0, 0, 0, 1000]], start_velocity_m_s=np.array([50.0, 0.0, 0.0]))
    with pytest.raises(InfeasibleError, match=r"takes up the start velocity of 50\.00 m/s"):
        Planner().plan(problem)


def test_start_faster_than_allowed() -> None:
    problem = replace(straight(), start_velocity_m_s=np.array([60.0, 0.0, 0.0]))
    with pytest.raises(InfeasibleError, match=r"breaks max_speed_m_s: 60\.000, allowed 50\.000"):
        Planner().plan(problem)


def test_start_sinking_through_the_floor() -> None:
    """10 m/s down, stopped with 5 m/s^2, takes 10 m: no plan 4 m above the floor, one 25 m above it."""
    falling = replace(straight(), start_m=[0, 0, 104], start_velocity_m_s=np.array([0.0, 0.0, -10.0]))
    with pytest.raises(InfeasibleError, match=r"sinks at 10\.000 m/s and needs 10\.000 m") as raised:
        Planner().plan(falling)
    assert raised.value.infeasibility.gap_m == pytest.approx(6.0)
    planned(replace(falling, start_m=[0, 0, 125]))


def test_overlap_and_tenure_are_kept() -> None:
    problem = paper_problem("M100_03", margin_m=25.0, min_overlap_s=8.0, min_tenure_s=25.0)
    solution = planned(problem)
    trajectory = solution.trajectory
    legs = np.bincount(trajectory.leg_index, weights=trajectory.durations_s)
    assert legs.min() >= 25.0
    for time, before, after in zip(
        trajectory.handover_times_s, trajectory.sequence, trajectory.sequence[1:], strict=False
    ):
        for station in (before, after):
            around = trajectory.evaluate(np.linspace(time - 4.0, time + 4.0, 101))
            away = np.linalg.norm(around - problem.station_positions_m[station], axis=-1)
            assert away.max() <= problem.ranges_m[station] + 1e-9


def test_more_asked_costs_more() -> None:
    times = [
        planned(paper_problem("M30_02", min_overlap_s=overlap)).trajectory.duration_s for overlap in (0.0, 2.0, 10.0)
    ]
    assert times == sorted(times)


def test_all_methods_know_all_limits() -> None:
    limits = {"max_jerk_m_s3": 5.0, "max_climb_m_s": 3.0, "max_descent_m_s": 2.0, "max_airspeed_m_s": 45.0}
    problem = paper_problem("M30_09", limits={**limits, "wind_m_s": (5.0, 5.0)}, margin_m=25.0, **FLYABLE)
    times = {method: planned(problem, method).trajectory.duration_s for method in ("joint", "fast", "paper")}
    assert times["joint"] <= times["fast"] * 1.001
    assert times["fast"] < times["paper"]


def test_energy_is_traded_for_time() -> None:
    """The dearer energy is, the slower the flight, the less of it is spent, and no plan is beaten at its own weight."""
    problem = paper_problem("M30_03", margin_m=25.0, **FLYABLE)
    weights = (0.0, 0.3, 1.0, 4.0)
    plans = [Planner().plan(problem, energy_weight=weight).trajectory for weight in weights]
    assert all(certify(problem, plan).feasible for plan in plans)
    times = [plan.duration_s for plan in plans]
    spent = [sum(energy_s(problem, plan)) for plan in plans]
    assert times == sorted(times)
    assert spent == sorted(spent, reverse=True)
    for weight, best in zip(weights, plans, strict=True):
        costs = [cost_s(problem, plan, weight) for plan in plans]
        assert cost_s(problem, best, weight) <= min(costs) * 1.001


def test_cruising_speed_of_the_cheapest_flight() -> None:
    """With weight 4 cruising pays best at v (2 w)^(-1/3) = 25 m/s of 50, over a long straight way."""
    problem = make_problem([0, 0, 100], [20000, 0, 100], [[10000, 0, 0, 15000]])
    trajectory = Planner().plan(problem, energy_weight=4.0).trajectory
    speed = np.linalg.norm(trajectory.evaluate(0.5 * trajectory.duration_s, 1))
    assert speed == pytest.approx(25.0, rel=0.02)


def test_energy_of_a_steady_flight() -> None:
    """100 s at half the top speed: drag (1/2)^3 x 100 = 12.5 s, no acceleration."""
    problem = make_problem([0, 0, 100], [2500, 0, 100], [[0, 0, 0, 5000]])
    line = np.linspace([0.0, 0.0, 100.0], [2500.0, 0.0, 100.0], 6)[None]
    steady = Trajectory(line, np.array([100.0]), np.array([0]))
    assert energy_s(problem, steady) == pytest.approx((0.0, 12.5))
    assert cost_s(problem, steady, 2.0) == pytest.approx(125.0)
    assert cost_s(problem, steady, 0.0) == 100.0


@pytest.mark.parametrize("method", ["joint", "fast"])
def test_energy_keeps_the_endurance(method: Any) -> None:
    """Left to itself the cheap flight takes 200 s and more; with 150 s of endurance it is as slow as that allows."""
    free = Planner().plan(straight(), method=method, energy_weight=4.0)
    assert free.trajectory.duration_s > 170.0
    limited = Planner().plan(straight(max_duration_s=165.0), method=method, energy_weight=4.0)
    assert certify(straight(max_duration_s=165.0), limited.trajectory).feasible
    assert limited.certificate.worst["duration_s"] <= 0.0


def test_a_fallback_saves_energy_too() -> None:
    problem = paper_problem("M30_03")
    quick = Planner(max_iterations=0).plan(problem)
    cheap = Planner(max_iterations=0).plan(problem, energy_weight=4.0)
    assert certify(problem, cheap.trajectory).feasible
    assert cost_s(problem, cheap.trajectory, 4.0) < cost_s(problem, quick.trajectory, 4.0)


@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_a_weight_that_makes_no_sense(weight: float) -> None:
    with pytest.raises(ValueError, match="energy_weight must be finite and not negative"):
        Planner().plan(straight(), energy_weight=weight)
