"""skyrelay bench planner: the figures and their arithmetic."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from api.bench.planner import compare as bench
from gcs.errors import PlanningFailed
from tests.support.missions.malformed import GOOD_LOCAL
from tests.support.processes.cli_process import Outcome

Cli = Callable[..., Outcome]


def test_figures_are_means_and_worsts_by_size() -> None:
    """Hand-worked: bound 100 s; ours 101 and 103 s in 1 s, the paper's 120 and 110 s in 4 and 2 s."""
    results = [
        bench.Result("a", 30, 100.0, bench.Run(101.0, 1.0, 3, "joint"), bench.Run(120.0, 4.0, 3, "paper")),
        bench.Result("b", 30, 100.0, bench.Run(103.0, 1.0, 3, "joint"), bench.Run(110.0, 2.0, 3, "paper")),
        bench.Result("c", 100, 200.0, bench.Run(202.0, 1.0, 5, "joint"), bench.Run(220.0, 2.0, 5, "paper")),
    ]
    document = bench.figures(results)
    small, large = document["summary"]
    assert document["overall"]["ours_gap_percent"] == pytest.approx({"mean": (1.0 + 3.0 + 1.0) / 3.0, "worst": 3.0})
    assert (small["stations"], small["missions"], large["missions"]) == (30, 2, 1)
    assert small["ours_gap_percent"] == pytest.approx({"mean": 2.0, "worst": 3.0})
    assert small["paper_gap_percent"] == pytest.approx({"mean": 15.0, "worst": 20.0})
    assert small["solve_time_ratio"] == pytest.approx({"mean": 0.375, "worst": 0.5})
    assert large["mission_time_ratio"]["mean"] == pytest.approx(202.0 / 220.0)
    assert (small["fast_gap_percent"], small["infeasible"], small["failed"]) == (None, 0, 0)


def test_missions_without_a_plan_count_and_do_not_blur_the_means() -> None:
    nan = float("nan")
    results = [
        bench.Result("a", 30, 100.0, bench.Run(102.0, 1.0, 3, "joint"), None, bench.Run(104.0, 0.5, 3, "joint")),
        bench.Result("b", 30, nan, None, None, infeasible="broken_chain: why"),
        bench.Result("c", 30, nan, None, None, failed="gave up"),
    ]
    document = bench.figures(results)
    (row,) = document["summary"]
    assert (row["missions"], row["infeasible"], row["failed"]) == (3, 1, 1)
    assert row["ours_gap_percent"] == pytest.approx({"mean": 2.0, "worst": 2.0})
    assert row["fast_gap_percent"] == pytest.approx({"mean": 4.0, "worst": 4.0})
    assert row["paper_gap_percent"] is row["solve_time_ratio"] is None
    json.dumps(document, allow_nan=False)


def test_a_draw_is_the_same_for_the_same_seed() -> None:
    first, again, other = bench.drawn(1, 7), bench.drawn(1, 7), bench.drawn(1, 8)
    assert [c.document for c in first] == [c.document for c in again]
    assert [c.document for c in first] != [c.document for c in other]
    assert [len(c.document["stations"]) for c in first] == [30, 100, 300]
    for case in first:
        ranges = [s["range_m"] for s in case.document["stations"]]
        assert 500.0 <= min(ranges) <= max(ranges) <= 1500.0


def test_a_mission_is_planned_both_ways(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "two.json").write_text(json.dumps(GOOD_LOCAL))
    outcome = cli("bench", "planner", "--missions", tmp_path, "--json")
    assert outcome.code == 0
    (row,) = json.loads(outcome.out)["missions"]
    # 1.5 km at 50 m/s and 5 m/s2, at rest at both ends: 1500 / 50 + 50 / 5 s is what nothing can beat
    assert row["lower_bound_s"] == pytest.approx(40.0, abs=0.01)
    assert row["lower_bound_s"] <= row["ours"]["mission_time_s"] <= row["paper"]["mission_time_s"]
    assert row["lower_bound_s"] <= row["fast"]["mission_time_s"] <= row["paper"]["mission_time_s"]
    assert row["mission_time_ratio"] == pytest.approx(row["ours"]["mission_time_s"] / row["paper"]["mission_time_s"])
    assert "1 of 1: two" in outcome.err


@pytest.mark.parametrize(
    ("content", "code", "said"),
    [(None, 2, "no missions"), (b"{", 2, "JSON"), (b"{}", 2, "is missing")],
)
def test_missions_that_cannot_be_measured_are_told(
    cli: Cli, tmp_path: Path, content: bytes | None, code: int, said: str
) -> None:
    if content is not None:
        (tmp_path / "m.json").write_bytes(content)
    outcome = cli("bench", "planner", "--missions", tmp_path)
    assert (outcome.code, outcome.out) == (code, "")
    assert said in outcome.err


def test_options_are_the_papers_the_missions_or_the_defaults(cli: Cli, tmp_path: Path) -> None:
    """Two ranges of 600 m 1,150 m apart: a margin of 25 m breaks the chain, which the paper's problem does not ask."""
    station = {"north_m": 0.0, "up_m": 0.0, "range_m": 600.0}
    thin = {
        **GOOD_LOCAL,
        "start": {"east_m": 0.0, "north_m": 0.0, "up_m": 110.0},
        "destination": {"east_m": 1150.0, "north_m": 0.0, "up_m": 110.0},
        "stations": [{"id": "A", "east_m": 0.0, **station}, {"id": "B", "east_m": 1150.0, **station}],
        "options": {"range_margin_m": 0},
    }
    (tmp_path / "thin.json").write_text(json.dumps(thin))
    run = ("bench", "planner", "--missions", tmp_path, "--ours-only", "--json")
    planned = {}
    for more in ((), ("--as-given",), ("--default-options",)):
        outcome = cli(*run, *more)
        assert outcome.code == 0, outcome.err
        (planned[more],) = json.loads(outcome.out)["missions"]
    assert planned[()]["paper"] is None
    # The mission's own options keep the default overlap: slower than the paper's problem.
    assert planned["--as-given",]["ours"]["mission_time_s"] > planned[()]["ours"]["mission_time_s"] + 1.0
    assert planned["--default-options",]["ours"] is None
    assert "broken_chain" in planned["--default-options",]["infeasible"]
    table = cli(*run[:-1], "--default-options")
    assert table.code == 0
    assert "thin" in table.out
    assert "0 of 1" in table.out


def test_without_the_reference_only_ours_can_be_measured(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    monkeypatch.setattr(bench, "reference_available", lambda: False)
    (tmp_path / "two.json").write_text(json.dumps(GOOD_LOCAL))
    refused = cli("bench", "planner", "--missions", tmp_path)
    assert (refused.code, refused.out) == (2, "")
    assert "skyrelay[bench]" in refused.err
    assert cli("bench", "planner", "--missions", tmp_path, "--ours-only").code == 0


def test_a_mission_that_should_have_a_plan_and_has_none_ends_with_1(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give_up(mission: object, **options: object) -> None:
        raise PlanningFailed("every planning method gave up")

    (tmp_path / "two.json").write_text(json.dumps(GOOD_LOCAL))
    monkeypatch.setattr(bench, "plan_mission", give_up)
    outcome = cli("bench", "planner", "--missions", tmp_path, "--ours-only")
    assert outcome.code == 1
    assert "FAILED: every planning method gave up" in outcome.out


@pytest.mark.slow
def test_long_chains_and_large_maps_are_measured(cli: Cli) -> None:
    outcome = cli("bench", "planner", "--segments", "12", "--routing", "200", "--seed", "3", "--json")
    assert outcome.code == 0, outcome.err
    document = json.loads(outcome.out)
    assert set(document) == {"segments", "routing"}
    (row,) = document["segments"]
    assert (row["segments"], row["stations"], row["ours"]["handovers"]) == (12, 12, 11)
    assert 0.0 <= row["ours"]["gap_percent"] <= row["paper"]["gap_percent"]
    assert row["paper_direct"]["gap_percent"] == pytest.approx(row["paper"]["gap_percent"], abs=2.0)
    (row,) = document["routing"]
    assert row["stations"] == 200
    # No sequence is shorter than the exact path, but for rounding; ours is hardly longer.
    assert -1e-6 <= row["excess_percent"] < 0.1
    assert row["excess_percent"] <= row["paper_excess_percent"]


def test_every_station_of_a_chain_is_needed() -> None:
    document = bench.chain(30, 5).document
    assert document == bench.chain(30, 5).document != bench.chain(30, 6).document
    at = np.array([[s["east_m"], s["north_m"]] for s in document["stations"]])
    reach = np.sqrt(np.array([s["range_m"] for s in document["stations"]]) ** 2 - 100.0**2)
    apart = np.linalg.norm(at[:, None] - at[None], axis=-1) - reach[:, None] - reach[None]
    k = np.arange(30)
    meets = apart < 0.0
    assert (meets == (np.abs(k[:, None] - k[None]) <= 1)).all()


def test_each_option_is_priced(cli: Cli, tmp_path: Path) -> None:
    """On a straight flight of 40 s across two ranges of 1 km, 1.5 km apart."""
    (tmp_path / "two.json").write_text(json.dumps(GOOD_LOCAL))
    outcome = cli("bench", "planner", "--missions", tmp_path, "--costs", "--json")
    assert outcome.code == 0, outcome.err
    costs = {row["option"]: row for row in json.loads(outcome.out)["costs"]}
    for row in costs.values():
        assert row["missions"] + row["infeasible"] + row["refused"] == 1
    # 10 m/s of headwind leave 40 m/s over ground: 1500 / 40 less 1500 / 50, and less to ramp up to.
    assert costs["10 m/s of headwind, airspeed limited"]["cost_s"]["mean"] == pytest.approx(5.5, abs=0.5)
    # One ramp to a = 5 and back at 5 m/s3, at either end: a / j = 1 s.
    assert 0.5 < costs["max_jerk_m_s3 5"]["cost_s"]["mean"] < 2.0
    assert costs["max_handovers, one less than planned"]["infeasible"] == 1
    assert costs["excluded_stations, the one longest in control"]["infeasible"] == 1


@pytest.mark.slow
def test_the_quick_bench_prints_its_table(cli: Cli) -> None:
    outcome = cli("bench", "planner", "--quick")
    assert outcome.code == 0
    for name in ("M30_01", "M100_01", "M300_01"):
        assert name in outcome.out
