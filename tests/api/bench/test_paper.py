"""skyrelay bench planner --paper: the tables' arithmetic, resuming, the figures, and options that make no sense."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.bench.paper import experiments
from api.bench.paper.page import cells_3
from api.bench.paper.results import Results, ResultsError, fingerprint
from api.bench.planner.cases import Case
from tests.support.missions.malformed import GOOD_LOCAL
from tests.support.processes.cli_process import Outcome

Cli = Callable[..., Outcome]
LIMITS = ("--time-limit", "0.2", "--rival-limit", "0.05")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with one mission of two stations."""
    missions = tmp_path / "missions"
    missions.mkdir()
    (missions / "two.json").write_text(json.dumps(GOOD_LOCAL))
    return missions


# -- what is kept ------------------------------------------------------------------------------------------------------


def test_results_are_found_again_by_unit_mission_and_settings(tmp_path: Path) -> None:
    path = tmp_path / "kept.jsonl"
    Results(path).add("plans", "m1", {"limit": 3.0}, {"x": 1}, name="one")
    kept = Results(path)
    assert kept.get("plans", "m1", {"limit": 3.0}) == {"x": 1}
    for unit, mission, settings in (
        ("other", "m1", {"limit": 3.0}),
        ("plans", "m2", {"limit": 3.0}),
        ("plans", "m1", {"limit": 4.0}),
    ):
        assert kept.get(unit, mission, settings) is None
    kept.add("plans", "m1", {"limit": 3.0}, {"x": 2})
    assert Results(path).get("plans", "m1", {"limit": 3.0}) == {"x": 2}
    assert len(Results(path)) == 1


@pytest.mark.parametrize("cut", [1, 20, 60])
def test_a_torn_last_line_is_dropped_and_what_follows_is_whole(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "kept.jsonl"
    first = Results(path)
    first.add("plans", "m1", {}, {"x": 1})
    first.add("plans", "m2", {}, {"x": 2})
    path.write_bytes(path.read_bytes()[:-cut])
    again = Results(path)
    assert again.dropped_torn_line
    assert (again.get("plans", "m1", {}), again.get("plans", "m2", {})) == ({"x": 1}, None)
    again.add("plans", "m3", {}, {"x": 3})
    assert [json.loads(line)["mission"] for line in path.read_text().splitlines()] == ["m1", "m3"]


@pytest.mark.parametrize("content", [b"hello\n", b"hello", b'{"unit": "plans"}\n', b"[]\n", b"\xff\xfe\n"])
def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "notes.txt"
    path.write_bytes(content)
    with pytest.raises(ResultsError):
        Results(path)
    assert path.read_bytes() == content


def test_a_mission_is_known_by_its_content() -> None:
    assert fingerprint(GOOD_LOCAL) == fingerprint(json.loads(json.dumps(dict(reversed(GOOD_LOCAL.items())))))
    assert fingerprint(GOOD_LOCAL) != fingerprint({**GOOD_LOCAL, "name": "another"})


# -- the run -----------------------------------------------------------------------------------------------------------


def units_told(err: str) -> list[str]:
    return [line.split(": ", 1)[1] for line in err.splitlines() if line.startswith("1 of 1: ")]


@pytest.mark.slow
def test_both_tables_come_with_this_planner_and_a_run_goes_on_where_it_was(
    cli: Cli, folder: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "kept.jsonl"
    run = ("bench", "planner", "--paper", "--missions", folder, "--results", kept, "--json", *LIMITS)
    outcome = cli(*run)
    assert outcome.code == 0, outcome.err
    document = json.loads(outcome.out)
    (row,) = document["table_3"]
    # 1.5 km between two stations whose ranges hold it all: the one sequence is DC's, and EM says it is complete.
    assert row["complete"]
    assert (row["sequences"]["em"], row["rank_dc"]) == (1, 1)
    assert row["mission_time_s"]["em"] == row["mission_time_s"]["dc"] > row["mission_time_s"]["ours"] >= 40.0
    (row,) = document["table_4"]
    assert row["variables"] == {"T": 2, "P": 36}
    assert set(row["mission_time_s"]) == {*experiments.ALLOCATIONS, "ours"}
    assert min(row["mission_time_s"], key=row["mission_time_s"].__getitem__) == "ours"
    gaps = document["summary"][0]["gap_percent"]
    assert gaps["ours"]["mean"] == pytest.approx(100.0 * (row["mission_time_s"]["ours"] / row["lower_bound_s"] - 1.0))
    assert len(units_told(outcome.err)) == len(kept.read_text().splitlines()) == 2 + len(experiments.ALLOCATIONS)

    # Again: nothing is measured, and the tables are the same.
    again = cli(*run)
    assert units_told(again.err) == []
    assert json.loads(again.out)["table_3"] == document["table_3"]
    # One measurement lost: only that one is made.
    kept.write_bytes(kept.read_bytes()[:-10])
    assert units_told(cli(*run).err) == ["two, AM, 0.05 s"]
    # What is there is shown, with a dash for an enumeration that was not made yet.
    kept.write_text("".join(line for line in kept.read_text().splitlines(True) if '"enumeration"' not in line))
    shown = cli(*run, "--kept-only")
    assert units_told(shown.err) == []
    (row,) = json.loads(shown.out)["table_3"]
    assert (row["mission_time_s"]["em"], row["rank_dc"], row["complete"]) == (None, None, None)
    assert json.loads(shown.out)["summary"][0]["gap_percent"]["EM"] is None
    assert cli(*[part for part in run if part != "--json"], "--kept-only").code == 0
    assert units_told(cli(*run).err) == ["two, EM, 0.2 s"]
    # This planner's column alone; an enumeration that came to its end stays one under any limit.
    assert units_told(cli(*run, "--redo", "ours").err) == ["two, this planner and DC"]
    assert units_told(cli(*run[:-2], "--rival-limit", "0.05", "--time-limit", "0.3").err) == []


@pytest.mark.slow
def test_the_figures_are_drawn(cli: Cli, folder: Path, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    other = {
        **GOOD_LOCAL,
        "stations": [*GOOD_LOCAL["stations"], {**GOOD_LOCAL["stations"][-1], "id": "C", "east_m": 9e3}],
    }
    (folder / "three.json").write_text(json.dumps(other))
    places = tmp_path / "new" / "figures"
    outcome = cli("bench", "planner", "--paper", "--missions", folder, "--figures", places, *LIMITS)
    assert outcome.code == 0, outcome.err
    page = (places / "tables.md").read_text()
    assert "| two | 2 | 36 |" in page
    assert page.count("| three |") == 2
    drawn = sorted(path.name for path in places.glob("*.png"))
    assert [name[:2] for name in drawn] == ["09", "10", "11", "12", "13", "14"]
    for name in drawn:
        assert name in outcome.out
        picture = image.open(places / name)
        assert min(picture.size) >= 300
        # Something is drawn: more than a background and its frame.
        assert len(np.unique(np.asarray(picture.convert("L")))) > 8


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--time-limit", "5"), "goes with --paper"),
        (("--results", "x.jsonl"), "goes with --paper"),
        (("--figures", "x"), "goes with --paper"),
        (("--redo", "ours"), "goes with --paper"),
        (("--kept-only",), "goes with --paper"),
        (("--paper", "--kept-only", "--quick"), "nothing to show"),
        (("--paper", "--time-limit", "0"), "more than 0"),
        (("--paper", "--rival-limit", "nan"), "more than 0"),
        (("--paper", "--rival-limit", "inf"), "more than 0"),
        (("--paper", "--redo", "theirs"), "ours, enumeration, rivals"),
        (("--paper", "--costs"), "do not go together"),
        (("--paper", "--default-options"), "do not go together"),
        (("--as-given", "--default-options"), "do not go together"),
        (("--only", "M7_01"), "no such mission"),
        (("--segments", "1"), "from 2"),
        (("--segments", "ten"), "from 2"),
        (("--routing", "10,,20"), "commas"),
        (("--random", "2", "--missions", "."), "do not go together"),
    ],
)
def test_options_that_make_no_sense_are_refused(cli: Cli, arguments: tuple[str, ...], said: str) -> None:
    outcome = cli("bench", "planner", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err


def test_a_results_file_or_folder_that_cannot_be_used_is_refused(cli: Cli, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("buy milk\n")
    run = ("bench", "planner", "--paper", "--missions", folder)
    for more in (("--results", tmp_path / "notes.txt"), ("--figures", tmp_path / "notes.txt")):
        outcome = cli(*run, *more)
        assert (outcome.code, outcome.out) == (2, "")
        assert more[0] in outcome.err


@pytest.mark.parametrize(("module", "arguments"), [("nlopt", ()), ("matplotlib", ("--figures", "x"))])
def test_a_missing_part_is_told_before_anything_is_measured(
    cli: Cli, folder: Path, monkeypatch: pytest.MonkeyPatch, module: str, arguments: tuple[str, ...]
) -> None:
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *more: None if name == module else real(name, *more))
    outcome = cli("bench", "planner", "--paper", "--missions", folder, *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert "skyrelay[bench]" in outcome.err
    assert "1 of 1" not in outcome.err


def test_ranks_and_gaps_are_hand_worked() -> None:
    """Bound 100 s: EM 110 s of 3 sequences, DC 120 s, ours 101 s; rivals all 150 s, so their mean gap is 50 %."""
    allocations: dict[str, Any] = {name: {"mission_time_s": 150.0} for name in experiments.ALLOCATIONS}
    row = {
        "name": "a",
        "stations": 30,
        "allocations": allocations,
        "enumeration": {
            "mission_time_s": 110.0,
            "planned": 3,
            "pruned": 2,
            "rank_dc": 2,
            "complete": True,
            "cpu_s": 9.0,
        },
        "plans": {
            "lower_bound_s": 100.0,
            "ours": {"mission_time_s": 101.0, "cpu_s": 0.1, "sequence": [0]},
            "decoupling": {"mission_time_s": 120.0, "cpu_s": 0.3, "sequence": [4, 1, 7]},
        },
    }
    (summary,) = experiments.summary([row])
    assert summary["gap_percent"]["COBYLA"] == pytest.approx({"mean": 50.0, "worst": 50.0})
    assert summary["gap_percent"]["DC"]["mean"] == pytest.approx(20.0)
    assert summary["complete_enumerations"] == 1
    (table,) = experiments.table_4([row])
    # A duration a segment; six control points of three coordinates a segment.
    assert table["variables"] == {"T": 3, "P": 54}
    assert experiments.table_3([row])[0]["sequences"] == {"em": 3, "em_pruned": 2, "dc": 1}


def test_a_longer_limit_has_a_table_of_its_own_and_another_order_none() -> None:
    """A longer run stands beside the other, not in its place; EM in another order is never taken for this one's."""
    settings = experiments.Settings(time_limit_s=0.1, rival_limit_s=0.02)
    case, results, told = Case("one", GOOD_LOCAL), Results(), []
    (row,) = experiments.run([case], settings, results, tell=told.append)
    mission = fingerprint(GOOD_LOCAL)
    cut_short = {**row["enumeration"], "complete": False}
    asked = {"time_limit_s": 0.1, "delta_t_s": experiments.DELTA_T_S, "order": experiments.EM_ORDER}
    kept = Results()
    for unit in experiments.units(settings):
        if unit.name != "enumeration":
            found = results.get(unit.name, mission, unit.settings)
            assert found is not None
            kept.add(unit.name, mission, unit.settings, found)
    kept.add("enumeration", mission, {**asked, "order": "depth first"}, cut_short)
    (row,) = experiments.run([case], settings, kept, kept_only=True, tell=told.append)
    assert row["enumeration"] is None
    before = len(told)
    experiments.run([case], settings, kept, tell=told.append)
    assert [text.split(", ")[-2:] for text in told[before:]] == [["EM", "0.1 s"]]
    kept.add("enumeration", mission, asked, cut_short)
    kept.add("enumeration", mission, {**asked, "time_limit_s": 9.0}, {**cut_short, "planned": 77})
    (row,) = experiments.run([case], settings, kept, kept_only=True, tell=told.append)
    assert [cells_3(shown)[1] for shown in experiments.table_3([row])] == ["1+"]
    (longer,) = experiments.table_3([row], "longer")
    assert (cells_3(longer)[1], longer["time_limit_s"]) == ("77+", 9.0)


def test_convergence_keeps_what_gains_and_the_end() -> None:
    points = [[0.0, 9.0], [0.1, 5.0], [0.2, 4.999], [0.3, 4.98], [0.4, 4.98], [0.5, 4.98]]
    assert experiments.thinned(points) == [[0.0, 9.0], [0.1, 5.0], [0.3, 4.98], [0.5, 4.98]]
    assert experiments.thinned(points[:1]) == points[:1]


def test_a_case_is_measured_once_whatever_its_file_is_called() -> None:
    """Two files with the same mission: the second one's measurements are the first one's."""
    told: list[str] = []
    settings = experiments.Settings(time_limit_s=0.1, rival_limit_s=0.02)
    cases = [Case("one", GOOD_LOCAL), Case("two", GOOD_LOCAL)]
    first, second = experiments.run(cases, settings, Results(), tell=told.append)
    assert all(text.startswith("1 of 2: one") for text in told)
    assert first["plans"] == second["plans"]
    assert (first["name"], second["name"]) == ("one", "two")
