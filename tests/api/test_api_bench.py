"""skyrelay bench planner: the figures and their arithmetic."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from api.bench import planner as bench
from tests.api.conftest import Outcome
from tests.malformed_missions import GOOD_LOCAL

Cli = Callable[..., Outcome]


def test_figures_are_means_and_worsts_by_size() -> None:
    """Hand-worked: bound 100 s; ours 101 and 103 s in 1 s, the paper's 120 and 110 s in 4 and 2 s."""
    results = [
        bench.Result("a", 30, 100.0, bench.Run(101.0, 1.0, 3, "joint"), bench.Run(120.0, 4.0, 3, "paper")),
        bench.Result("b", 30, 100.0, bench.Run(103.0, 1.0, 3, "joint"), bench.Run(110.0, 2.0, 3, "paper")),
        bench.Result("c", 100, 200.0, bench.Run(202.0, 1.0, 5, "joint"), bench.Run(220.0, 2.0, 5, "paper")),
    ]
    small, large = bench.figures(results)["summary"]
    assert (small["stations"], small["missions"], large["missions"]) == (30, 2, 1)
    assert small["ours_gap_percent"] == pytest.approx({"mean": 2.0, "worst": 3.0})
    assert small["paper_gap_percent"] == pytest.approx({"mean": 15.0, "worst": 20.0})
    assert small["solve_time_ratio"] == pytest.approx({"mean": 0.375, "worst": 0.5})
    assert large["mission_time_ratio"]["mean"] == pytest.approx(202.0 / 220.0)


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


@pytest.mark.slow
def test_the_quick_bench_prints_its_table(cli: Cli) -> None:
    outcome = cli("bench", "planner", "--quick")
    assert outcome.code == 0
    for name in ("M30_01", "M100_01", "M300_01"):
        assert name in outcome.out
