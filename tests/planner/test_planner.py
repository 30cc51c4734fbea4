"""`Planner`: every feasible mission gets a certified plan, every other one a reason and a remedy that works."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import Infeasibility, InfeasibleError, Planner, Problem, Solution, certify
from planner.infeasibility.application import remedied
from planner.infeasibility.diagnosis import diagnose
from planner.remedy import (
    AddStation,
    Change,
    LowerElevation,
    LowerElevations,
    Move,
    RaiseAllRanges,
    RaiseLimit,
    RaiseRange,
    Remedy,
    SetAltitude,
    WidenBand,
)
from tests.support.missions.problems import digest, make_problem, paper_problem
from tests.support.paths import ROOT

DEFAULTS = {"margin_m": 25.0, "min_overlap_s": 5.0, "min_tenure_s": 10.0}


def assert_sound(problem: Problem, solution: Solution) -> None:
    """Certified by a fresh measurement, no faster than the bound, ends where it should."""
    certificate = certify(problem, solution.trajectory)
    assert certificate.feasible, certificate.worst
    assert solution.certificate.worst == certificate.worst
    assert solution.trajectory.duration_s >= solution.lower_bound_s * (1.0 - 1e-9)
    assert solution.trajectory.evaluate(0.0) == pytest.approx(problem.start_m, abs=1e-6)
    assert solution.trajectory.evaluate(solution.trajectory.duration_s) == pytest.approx(
        problem.destination_m, abs=1e-6
    )


def gap(solution: Solution) -> float:
    return solution.trajectory.duration_s / solution.lower_bound_s - 1.0


def test_gaps_on_the_paper_like_missions(mission_name: str) -> None:
    """Every mission within 1.6 % of what physics allows (means of 0.6, 0.5 and 0.4 % by size)."""
    problem = paper_problem(mission_name)
    solution = Planner().plan(problem)
    assert_sound(problem, solution)
    assert solution.method == "joint"
    assert solution.notes == ()
    assert gap(solution) < 0.016


@pytest.mark.parametrize("name", ["M30_01", "M30_07", "M100_08", "M300_06"])
def test_fast_is_close_behind(name: str) -> None:
    problem = paper_problem(name)
    solution = Planner().plan(problem, method="fast")
    assert_sound(problem, solution)
    assert gap(solution) < 0.03


def test_paper_method() -> None:
    problem = paper_problem("M30_03")
    solution = Planner().plan(problem, method="paper")
    assert_sound(problem, solution)
    assert solution.method == "paper"
    assert gap(solution) > gap(Planner().plan(problem, method="fast"))


def test_unknown_method_is_named() -> None:
    with pytest.raises(ValueError, match=r"unknown method 'slow': one of joint, fast, paper"):
        Planner().plan(paper_problem("M30_03"), method="slow")  # type: ignore[arg-type]


# What these missions took with a first sequence and one entry, one own and one exit piece a station.
BEFORE_S = {"M30_01": 204.2, "M30_05": 150.7 * 1.005, "M100_06": 291.4, "M300_01": 437.0}


@pytest.mark.parametrize("name", sorted(BEFORE_S))
def test_flyable_plans_are_no_slower_than_known(name: str) -> None:
    problem = paper_problem(name, **DEFAULTS)
    solution = Planner().plan(problem)
    assert_sound(problem, solution)
    assert solution.trajectory.duration_s <= BEFORE_S[name] * 1.002


@pytest.mark.slow
def test_flyable_plans_cost_little_on_average() -> None:
    """Missions of 30 and 100 stations with overlap, margin and tenure: 8 % over the bound on average at most."""
    gaps = []
    for name in [f"M{size}_{k:02d}" for size in (30, 100) for k in range(1, 11)]:
        problem = paper_problem(name, **DEFAULTS)
        if diagnose(problem) is not None:
            with pytest.raises(InfeasibleError):
                Planner().plan(problem)
            continue
        solution = Planner().plan(problem)
        assert_sound(problem, solution)
        gaps.append(gap(solution))
    assert len(gaps) == 13
    assert np.mean(gaps) < 0.065


def test_same_problem_same_plan() -> None:
    problem = paper_problem("M30_06", **DEFAULTS)
    planner = Planner()
    first = digest(planner.plan(problem))
    planner.plan(paper_problem("M30_03"))
    assert digest(planner.plan(problem)) == first
    assert digest(Planner().plan(problem)) == first


@pytest.mark.slow
def test_same_plan_in_another_process() -> None:
    code = (
        "from planner import Planner;"
        "from tests.support.missions.problems import digest, paper_problem;"
        "print(digest(Planner().plan(paper_problem('M30_03'))))"
    )
    runs = {
        subprocess.run(
            [sys.executable, "-c", code],
            check=True,
            cwd=ROOT,
            capture_output=True,
            text=True,
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)},
        ).stdout
        for seed in ("1", "2")
    }
    assert runs == {digest(Planner().plan(paper_problem("M30_03"))) + "\n"}


@pytest.mark.parametrize("options", [{}, DEFAULTS])
def test_a_solver_that_gives_up_is_replaced(options: dict[str, float]) -> None:
    """With no iterations allowed the joint problem has no answer; the plan is still there and says how."""
    problem = paper_problem("M30_03", **options)
    solution = Planner(max_iterations=0).plan(problem)
    assert_sound(problem, solution)
    assert solution.method == "alternating minimisation"
    assert any("joint" in note for note in solution.notes)


def test_a_solver_stopped_early_is_owned_up_to() -> None:
    problem = paper_problem("M30_03")
    solution = Planner(max_iterations=12).plan(problem)
    assert_sound(problem, solution)
    assert solution.notes


def test_time_limit_leaves_out_sequences_not_plans() -> None:
    """A clock that runs an hour a look: the first sequence is still planned."""
    problem = paper_problem("M30_01", **DEFAULTS)
    ticks = iter(range(0, 10**9, 3600))
    hurried = Planner(clock=lambda: float(next(ticks))).plan(problem, time_limit_s=1.0)
    assert_sound(problem, hurried)
    assert hurried.trajectory.duration_s >= Planner().plan(problem).trajectory.duration_s


# --- awkward but feasible -------------------------------------------------------------------------------------------


def test_start_is_destination() -> None:
    problem = make_problem([0, 0, 110], [0, 0, 110], [[0, 0, 0, 1000]])
    solution = Planner().plan(problem)
    assert_sound(problem, solution)
    assert solution.trajectory.duration_s < 10.0


def test_a_metre_away() -> None:
    problem = make_problem([0, 0, 110], [1, 0, 110], [[0, 0, 0, 1000]])
    assert_sound(problem, Planner().plan(problem))


def test_one_station_straight_ahead() -> None:
    """3 km in one range: 3000/50 + 10 = 70 s is the bound, and the plan is within 1 %."""
    problem = make_problem([-1500, 0, 110], [1500, 0, 110], [[0, 0, 0, 2000]])
    solution = Planner().plan(problem)
    assert_sound(problem, solution)
    assert solution.lower_bound_s == pytest.approx(70.0)
    assert gap(solution) < 0.01


@pytest.mark.parametrize("options", [{}, {"min_overlap_s": 5.0, "min_tenure_s": 10.0}])
@pytest.mark.parametrize("depth_m", [1.5e-3, 0.1, 10.0])
def test_tiny_overlaps_are_stopped_in(depth_m: float, options: dict[str, float]) -> None:
    """Two ranges that barely meet at 100 m, antennas there: a vehicle can wait in an overlap of a millimetre."""
    stations = [[0, 0, 100, 1000], [2000 - depth_m, 0, 100, 1000]]
    problem = make_problem([0, 300, 100], [2000, 300, 110], stations, **options)
    assert_sound(problem, Planner().plan(problem))


def test_a_flat_band() -> None:
    """Minimum and maximum altitude the same: a plan at that altitude exactly."""
    problem = make_problem([0, 0, 100], [1600, 0, 100], [[0, 0, 0, 1000], [1600, 0, 0, 1000]], band=(100.0, 100.0))
    assert_sound(problem, Planner().plan(problem))


def test_ends_on_the_edge_of_range_and_band() -> None:
    edge = float(np.sqrt(1000.0**2 - 100.0**2)) * (1 - 1e-12)
    problem = make_problem([-edge, 0, 100], [1600 + edge, 0, 100], [[0, 0, 0, 1000], [1600, 0, 0, 1000]])
    assert_sound(problem, Planner().plan(problem))


@pytest.mark.parametrize(("speed", "accel"), [(100.0, 0.5), (2.0, 20.0), (0.5, 0.05), (300.0, 30.0)])
def test_limits_far_apart(speed: float, accel: float) -> None:
    problem = paper_problem("M30_03")
    limits = replace(problem.limits, max_speed_m_s=speed, max_accel_m_s2=accel)
    changed = replace(problem, limits=limits)
    solution = Planner().plan(changed, method="fast")
    assert_sound(changed, solution)
    assert gap(solution) < 0.2


def test_huge_ranges_and_far_from_the_origin() -> None:
    """Ranges of 100 km, 1,000 km from the plane's origin: rounding is there, the certificate holds."""
    stations = [[1e6, 1e6, 0, 1e5], [1.15e6, 1e6, 0, 1e5], [1.3e6, 1.02e6, 0, 1e5]]
    problem = make_problem([0.95e6, 1e6, 1000], [1.34e6, 1.02e6, 1500], stations, band=(500.0, 2000.0))
    solution = Planner().plan(problem)
    assert_sound(problem, solution)
    assert gap(solution) < 0.01


@st.composite
def chains(draw: st.DrawFn) -> Problem:
    """A chain of stations on hills and plains whose overlaps are at least a few millimetres deep."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 5))
    scale = 10.0 ** draw(st.floats(2.0, 5.0))
    low = draw(st.floats(50.0, 300.0))
    band = (low, low + draw(st.sampled_from([0.0, 5.0, 100.0, 1000.0])))
    stations: list[list[float]] = []
    at, heading = np.zeros(2), 0.0
    for _ in range(count):
        height = draw(st.sampled_from([0.0, low, 0.5 * (band[0] + band[1]), band[1] + 100.0]))
        # Large enough to reach the band from wherever the antenna stands.
        reach = scale * rng.uniform(0.3, 1.0) + abs(height - low) + 100.0
        if stations:
            heading += draw(st.floats(-2.0, 2.0))
            # How far the discs overlap at the altitude where most of both is: from barely to half.
            share = draw(st.sampled_from([1e-5, 1e-3, 0.1, 0.5, 1.0]))
            z = float(np.clip(0.5 * (height + stations[-1][2]), *band))
            radii = [np.sqrt(max(r**2 - (z - h) ** 2, 0.0)) for h, r in ((height, reach), stations[-1][2:])]
            at = at + (sum(radii) - share * min(radii)) * np.array([np.cos(heading), np.sin(heading)])
        stations.append([*at, height, reach])
    ends = []
    for station in (stations[0], stations[-1]):
        z = float(np.clip(station[2], *band))
        radius = 0.9 * np.sqrt(station[3] ** 2 - (z - station[2]) ** 2)
        angle = rng.uniform(0, 2 * np.pi)
        ends.append(
            [*(np.array(station[:2]) + rng.uniform(0, 1) * radius * np.array([np.cos(angle), np.sin(angle)])), z]
        )
    overlap, tenure = draw(st.sampled_from([(0.0, 0.0), (5.0, 10.0), (20.0, 0.0), (0.0, 60.0)]))
    return make_problem(
        ends[0],
        ends[1],
        stations,
        band=band,
        speed_m_s=10.0 ** draw(st.floats(0.5, 2.0)),
        accel_m_s2=10.0 ** draw(st.floats(-0.5, 1.0)),
        min_overlap_s=overlap,
        min_tenure_s=tenure,
    )


@pytest.mark.slow
@settings(max_examples=40)
@given(chains())
def test_every_chain_gets_a_plan_or_a_reason(problem: Problem) -> None:
    """Hills, thin overlaps, odd limits: planned and certified exactly when nothing is wrong with the ranges."""
    found = diagnose(problem)
    if found is None:
        assert_sound(problem, Planner().plan(problem, method="fast"))
    else:
        assert why(problem).reason == found.reason


# --- infeasible -----------------------------------------------------------------------------------------------------


def why(problem: Problem) -> Infeasibility:
    with pytest.raises(InfeasibleError) as raised:
        Planner().plan(problem)
    assert str(raised.value) == raised.value.infeasibility.message
    return raised.value.infeasibility


def changed(problem: Problem, change: Change) -> Problem:
    """The problem after a change, by the words of the change."""
    limits = problem.limits
    match change:
        case RaiseRange():
            ranges = problem.ranges_m.copy()
            ranges[change.station] += change.by_m
            return replace(problem, ranges_m=ranges)
        case RaiseAllRanges():
            return replace(problem, ranges_m=problem.ranges_m + change.by_m)
        case WidenBand():
            low = limits.min_alt_m if change.min_alt_m is None else change.min_alt_m
            high = limits.max_alt_m if change.max_alt_m is None else change.max_alt_m
            return replace(problem, limits=replace(limits, min_alt_m=low, max_alt_m=high))
        case RaiseLimit():
            if change.limit == "max_handovers":
                return replace(problem, max_handovers=int(change.to))
            raised: dict[str, Any] = {change.limit: change.to}
            return replace(problem, limits=replace(limits, **raised))
        case Move() | SetAltitude():
            name = f"{change.of}_m"
            point = np.array(change.position_m) if isinstance(change, Move) else getattr(problem, name).copy()
            if isinstance(change, SetAltitude):
                point[2] = change.alt_m
            moved: dict[str, Any] = {name: point}
            return replace(problem, **moved)
        case LowerElevation() | LowerElevations():
            assert problem.min_elevation_deg is not None
            angles = problem.min_elevation_deg.copy()
            if isinstance(change, LowerElevation):
                angles[change.station] = change.to_deg
            else:
                angles = np.where(angles < 0.0, angles, np.maximum(angles - change.by_deg, 0.0))
            return replace(problem, min_elevation_deg=angles)
        case AddStation():
            masks = problem.min_elevation_deg
            return replace(
                problem,
                station_positions_m=np.vstack([problem.station_positions_m, change.position_m]),
                ranges_m=np.append(problem.ranges_m, change.range_m),
                min_elevation_deg=None if masks is None else np.append(masks, -90.0),
            )
    raise AssertionError(change)


def cured(problem: Problem, remedy: Remedy) -> Problem:
    """The problem after every change of a remedy; `planner.infeasibility.remedied` makes the same of it."""
    for change in remedy:
        problem = changed(problem, change)
    return problem


def assert_remedies_work(problem: Problem, infeasibility: Infeasibility) -> None:
    assert infeasibility.remedies
    for remedy in infeasibility.remedies:
        mended = cured(problem, remedy)
        assert_same(mended, remedied(problem, remedy))
        assert_sound(mended, Planner().plan(mended, method="fast"))


def assert_same(one: Problem, other: Problem) -> None:
    """But for bounds on ranges, which go with the ranges they bounded."""
    for name, value in vars(replace(one, bound_ranges_m=None)).items():
        np.testing.assert_array_equal(value, getattr(replace(other, bound_ranges_m=None), name), name)


def first_of(found: Infeasibility) -> Any:
    """The first change of the first remedy."""
    return found.remedies[0][0]


def alternatives(found: Infeasibility) -> dict[type, Any]:
    """The other remedies' first changes, by their kind."""
    return {type(remedy[0]): remedy[0] for remedy in found.remedies[1:]}


def test_a_gap_is_measured_and_closed() -> None:
    """Antennas at 100 m, 100 m between the ranges: raise one by 100 m, all by 50 m, or put a station between."""
    problem = make_problem([0, 0, 100], [2100, 0, 100], [[0, 0, 100, 1000], [2100, 0, 100, 1000]])
    found = why(problem)
    assert (found.reason, found.stations) == ("broken_chain", (0, 1))
    assert found.gap_m == pytest.approx(100.0)
    assert found.position_m == pytest.approx((1050.0, 0.0, 100.0))
    assert first_of(found).by_m == pytest.approx(100.0, abs=0.01)
    assert alternatives(found)[RaiseAllRanges].by_m == pytest.approx(50.0, abs=0.01)
    assert alternatives(found)[AddStation].range_m == pytest.approx(50.0, abs=0.01)
    assert_remedies_work(problem, found)


@pytest.mark.slow
def test_a_lower_floor_closes_a_gap() -> None:
    """Antennas at 0, ranges 1000 m, 1980 m apart: discs meet below sqrt(1000^2 - 990^2) = 141 m, the floor is 150."""
    stations = [[0, 0, 0, 1000], [1980, 0, 0, 1000]]
    problem = make_problem([0, 0, 150], [1980, 0, 150], stations, band=(150.0, 200.0))
    found = why(problem)
    assert alternatives(found)[WidenBand].min_alt_m == pytest.approx(np.sqrt(1000.0**2 - 990.0**2), abs=0.1)
    assert_remedies_work(problem, found)


@pytest.mark.parametrize("end", ["start", "destination"])
def test_an_end_out_of_range(end: str) -> None:
    far, near = [1500.0, 0.0, 100.0], [0.0, 0.0, 100.0]
    ends = (far, near) if end == "start" else (near, far)
    problem = make_problem(*ends, [[0, 0, 100, 1000]])
    found = why(problem)
    assert found.reason == f"{end}_uncovered"
    assert found.gap_m == pytest.approx(500.0)
    assert_remedies_work(problem, found)


def test_two_faults_are_both_told() -> None:
    """The destination is out of range and the chain is broken: the remedy covers both."""
    stations = [[0, 0, 100, 1000], [2100, 0, 100, 1000]]
    problem = make_problem([0, 0, 100], [3200, 0, 100], stations)
    found = why(problem)
    assert found.reason == "destination_uncovered"
    assert "besides" in found.message
    assert {change.station for change in found.remedies[0] if isinstance(change, RaiseRange)} == {0, 1}
    assert_remedies_work(problem, found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["M30_08", "M100_01", "M100_05", "M300_05"])
def test_remedies_of_the_missions_a_margin_breaks(name: str) -> None:
    problem = paper_problem(name, **DEFAULTS)
    assert_remedies_work(problem, why(problem))


def test_an_end_outside_the_band() -> None:
    found = why(make_problem([0, 0, 90], [500, 0, 100], [[0, 0, 0, 1000]]))
    assert found.reason == "start_altitude"
    assert found.remedies == ((SetAltitude("start", 100.0, 10.0),), (WidenBand(10.0, min_alt_m=90.0),))


def test_an_end_seen_too_low() -> None:
    """100 m up and 900 m away: 6.34 degrees, and 20 are asked for; 275 m away they are 20."""
    angles = {"min_elevation_deg": np.array([20.0])}
    problem = make_problem([900, 0, 100], [0, 0, 100], [[0, 0, 0, 1000]], band=(100.0, 100.0), **angles)
    found = why(problem)
    assert (found.reason, found.stations, found.gap_m) == ("start_uncovered", (0,), 0.0)
    assert first_of(found).to_deg == pytest.approx(np.degrees(np.arctan2(100.0, 900.0)))
    assert alternatives(found)[Move].by_m == pytest.approx(900.0 - 100.0 / np.tan(np.radians(20.0)), abs=1e-3)
    assert alternatives(found)[LowerElevations].by_deg == pytest.approx(20.0 - first_of(found).to_deg, abs=1e-4)
    assert_remedies_work(problem, found)


def test_fewer_handovers_by_longer_ranges() -> None:
    """Three stations in a row need two handovers; with one, the outer ones must meet, or one reach an end."""
    stations = [[0, 0, 100, 1000], [1900, 0, 100, 1000], [3800, 0, 100, 1000]]
    problem = make_problem([0, 0, 100], [3800, 0, 100], stations, max_handovers=1)
    found = why(problem)
    assert first_of(found) == RaiseLimit("max_handovers", 2)
    assert alternatives(found)[RaiseAllRanges].by_m == pytest.approx(900.0, abs=0.01)
    assert alternatives(found)[RaiseRange].by_m == pytest.approx(900.0, abs=0.01)
    assert_remedies_work(problem, found)


def test_an_endurance_no_one_could_keep_is_known_at_once() -> None:
    """1500 m take 1500/50 + 10 = 40 s at best."""
    stations = [[0, 0, 0, 2000]]
    problem = make_problem([0, 0, 100], [1500, 0, 100], stations, limits={"max_duration_s": 39.0})
    found = why(problem)
    assert found.reason == "limits"
    assert "no trajectory takes less than 40.0 s" in found.message
    assert found.remedies == ((RaiseLimit("max_duration_s", pytest.approx(40.0)),),)


def test_an_endurance_just_missed_names_the_time_found() -> None:
    problem = make_problem([0, 0, 100], [1500, 0, 100], [[0, 0, 0, 2000]], limits={"max_duration_s": 40.01})
    found = why(problem)
    assert "the fastest plan found takes" in found.message
    mended = cured(problem, found.remedies[0])
    solution = Planner().plan(mended)
    assert_sound(mended, solution)
    assert solution.certificate.worst["duration_s"] == 0.0


def test_wind_above_the_airspeed() -> None:
    limits = {"max_airspeed_m_s": 20.0, "wind_m_s": (0.0, 25.0)}
    found = why(make_problem([0, 0, 100], [1500, 0, 100], [[0, 0, 0, 2000]], limits=limits))
    assert found.reason == "limits"
    assert found.limit == "max_airspeed_m_s"


def test_too_few_handovers_allowed() -> None:
    stations = [[0, 0, 0, 1000], [1600, 0, 0, 1000], [3200, 0, 0, 1000]]
    problem = make_problem([0, 0, 100], [3200, 0, 100], stations, max_handovers=1)
    found = why(problem)
    assert found.reason == "limits"
    assert_remedies_work(problem, found)
