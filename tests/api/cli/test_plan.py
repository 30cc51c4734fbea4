"""plan, handovers, setpoints and report on the command line: what goes in, what comes out, how they complain."""

from __future__ import annotations

import csv
import io
import json
import subprocess
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

from gcs.plan import read_plan
from tests.support.checker import check_plan
from tests.support.missions.infeasible import INFEASIBLE
from tests.support.missions.malformed import GOOD, MALFORMED
from tests.support.processes.cli_process import SKYRELAY, Outcome

Cli = Callable[..., Outcome]


def body_of(document: Any) -> bytes:
    return document if isinstance(document, bytes) else json.dumps(document).encode()


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The plan of `GOOD`, made by the command itself."""
    place = tmp_path_factory.mktemp("plan")
    (place / "mission.json").write_bytes(body_of(GOOD))
    command = [*SKYRELAY, "plan", str(place / "mission.json"), "-o", str(place / "plan.json")]
    subprocess.run(command, check=True, capture_output=True)
    return place / "plan.json"


# -- plan -------------------------------------------------------------------------------------------------------------


def test_a_plan_is_summed_up_and_kept(cli: Cli, tmp_path: Path) -> None:
    (tmp_path / "mission.json").write_bytes(body_of(GOOD))
    outcome = cli("plan", tmp_path / "mission.json", "-o", tmp_path / "plan.json")
    assert (outcome.code, outcome.err) == (0, "")
    document = json.loads((tmp_path / "plan.json").read_bytes())
    assert check_plan(document, GOOD) == []
    for said in ("Den Helder to Texel", "den-helder > texel", document["plan_sha256"], "plan.json"):
        assert said in outcome.out
    (handover,) = document["handovers"]
    (row,) = [line for line in outcome.out.splitlines() if line.startswith("1 ")]
    assert f"{handover['position']['lat_deg']:.6f}" in row


def test_json_goes_to_standard_output_alone(cli: Cli) -> None:
    outcome = cli("plan", "-", "--json", stdin=body_of(GOOD))
    assert (outcome.code, outcome.err) == (0, "")
    plan = read_plan(json.loads(outcome.out))
    assert plan.to_document() == json.loads(outcome.out)
    dash = cli("plan", "-", "-o", "-", stdin=body_of(GOOD))
    assert json.loads(dash.out)["plan_sha256"] == plan.plan_sha256  # deterministic, and `-o -` is standard output


def test_options_override_those_of_the_file(cli: Cli) -> None:
    outcome = cli("plan", "-", "--json", "--option", "min_overlap_s=20", "--option", "on_arrival=hold",
                  "--option", 'excluded_stations=[]', stdin=body_of(GOOD))  # fmt: skip
    document = json.loads(outcome.out)
    options = document["mission"]["options"]
    assert (options["min_overlap_s"], options["on_arrival"], options["range_margin_m"]) == (20.0, "hold", 25.0)
    (handover,) = document["handovers"]
    assert handover["overlap"]["end_s"] - handover["overlap"]["start_s"] >= 20.0


def test_fast_plans_by_another_method_and_keeps_every_limit(cli: Cli) -> None:
    outcome = cli("plan", "-", "--json", "--fast", stdin=body_of(GOOD))
    document = json.loads(outcome.out)
    assert document["certificate"]["feasible"] is True
    assert check_plan(document, GOOD) == []


def test_what_the_options_cost_is_told_and_kept(cli: Cli, tmp_path: Path) -> None:
    """Over the straight way of `GOOD` an overlap of 5 s costs nothing; arriving later costs what it says."""
    outcome = cli("plan", "-", "--fast", "--costs", "--option", "arrival_s=1000", "-o", tmp_path / "plan.json",
                  stdin=body_of(GOOD))  # fmt: skip
    assert (outcome.code, outcome.err) == (0, "")
    costs = {cost["option"]: cost for cost in json.loads((tmp_path / "plan.json").read_bytes())["costs"]}
    asked = {"min_overlap_s", "range_margin_m", "min_tenure_s", "arrival_s", "handover_tolerance", "overlap_target_s"}
    assert set(costs) == {*asked, "together"}
    assert costs["arrival_s"]["cost_s"] > 200.0
    (row,) = [line for line in outcome.out.splitlines() if line.split()[:1] == ["arrival_s"]]
    assert f"{costs['arrival_s']['cost_s']:+.1f} s" in row
    assert cli("handovers", tmp_path / "plan.json").code == 0


@pytest.mark.parametrize(
    ("option", "said"),
    [("min_overlap_s", "NAME=VALUE"), ("min_overlap=5", "min_overlap_s"), ("min_overlap_s=-1", "must not be negative"),
     ("max_handovers=some", "whole number")],
)  # fmt: skip
def test_a_bad_option_is_told(cli: Cli, option: str, said: str) -> None:
    outcome = cli("plan", "-", "--option", option, stdin=body_of(GOOD))
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err


@pytest.mark.parametrize(("name", "document", "where"), MALFORMED, ids=[name for name, *_ in MALFORMED])
def test_a_malformed_mission_is_exit_2_with_the_place_on_stderr(
    cli: Cli, tmp_path: Path, name: str, document: Any, where: str
) -> None:
    (tmp_path / "plan.json").write_text("as it was")
    outcome = cli("plan", "-", "-o", tmp_path / "plan.json", stdin=body_of(document))
    assert (outcome.code, outcome.out) == (2, "")
    where = "mission" if b"NaN" in body_of(document) or b"Infinity" in body_of(document) else where
    assert outcome.err.startswith("error: ")
    assert where in outcome.err
    assert "Traceback" not in outcome.err
    assert (tmp_path / "plan.json").read_text() == "as it was"


@pytest.mark.parametrize(("name", "document", "reason", "words"), INFEASIBLE, ids=[name for name, *_ in INFEASIBLE])
def test_an_infeasible_mission_is_exit_3_with_reason_and_fix(
    cli: Cli, name: str, document: Any, reason: str, words: tuple[str, ...]
) -> None:
    outcome = cli("plan", "-", stdin=body_of(document))
    assert (outcome.code, outcome.out) == (3, "")
    assert f"reason:   {reason}" in outcome.err
    assert "Traceback" not in outcome.err
    flat = " ".join(outcome.err.split())
    assert all(word in flat for word in words), outcome.err


def test_many_faults_are_all_told(cli: Cli) -> None:
    bad = {**GOOD, "limits": {}, "stations": [{"id": "a"}], "start": {}}
    outcome = cli("plan", "-", stdin=body_of(bad))
    assert outcome.err.count("where:") >= 8
    assert "faults" in outcome.err.splitlines()[0]


# -- handovers --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_schedule_in_every_form(cli: Cli, plan_file: Path, tmp_path: Path) -> None:
    plan = json.loads(plan_file.read_bytes())
    table = cli("handovers", plan_file)
    assert table.code == 0
    assert "den-helder" in table.out
    rows = list(csv.DictReader(io.StringIO(cli("handovers", plan_file, "--format", "csv").out)))
    assert [float(row["time_s"]) for row in rows] == [h["time_s"] for h in plan["handovers"]]
    launched = cli("handovers", plan_file, "--format", "json", "--launch", "2026-11-22T10:00:00+01:00")
    assert json.loads(launched.out)["launch_utc"] == "2026-11-22T09:00:00.000Z"
    kept = cli("handovers", "-", "--format", "csv", "-o", tmp_path / "h.csv", stdin=plan_file.read_bytes())
    assert (kept.code, kept.out) == (0, "")
    assert (tmp_path / "h.csv").read_text().count("\n") == 1 + len(plan["handovers"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--format", "xls"], "table, json, csv"),
        (["--station", "atlantis"], "atlantis"),
        (["--launch", "noon"], "RFC 3339"),
    ],
)
def test_a_schedule_that_cannot_be_made_is_told(cli: Cli, plan_file: Path, arguments: list[str], said: str) -> None:
    outcome = cli("handovers", plan_file, *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err


# -- plans as input ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [["handovers"], ["setpoints"], ["fly", "--autopilot=px4", "--link=udpin:127.0.0.1:0"]]
)
def test_what_is_no_plan_is_told(cli: Cli, plan_file: Path, command: list[str]) -> None:
    altered = json.loads(plan_file.read_bytes())
    altered["mission_time_s"] += 1.0
    for data, said in (
        (body_of(GOOD), "plan it first"),
        (body_of(altered), "hash"),
        (b"{}", "plan"),
        (b"[1, 2", "plan"),
        (b"", "plan"),
        (b'{"plan_sha256": NaN}', "NaN"),
    ):
        outcome = cli(command[0], "-", *command[1:], stdin=data)
        assert (outcome.code, outcome.out) == (2, ""), outcome
        assert said in outcome.err
        assert "Traceback" not in outcome.err


# -- setpoints --------------------------------------------------------------------------------------------------------


def test_setpoints_step_by_the_rate_and_end_at_the_mission_time(cli: Cli, plan_file: Path) -> None:
    plan = json.loads(plan_file.read_bytes())
    rows = list(csv.DictReader(io.StringIO(cli("setpoints", plan_file, "--rate", "4").out)))
    times = [float(row["time_s"]) for row in rows]
    assert times[:3] == [0.0, 0.25, 0.5]
    assert times[-1] == pytest.approx(plan["mission_time_s"], abs=1e-6)
    marked = [row for row in rows if row["handover"]]
    assert [(row["handover"], row["station"]) for row in marked] == [("1", "texel")]
    lines = cli("setpoints", plan_file, "--rate", "4", "--format", "jsonl").out.splitlines()
    assert len(lines) == len(rows)
    assert json.loads(lines[-1])["time_s"] == pytest.approx(plan["mission_time_s"], abs=1e-6)


def test_a_log_is_written_whole(cli: Cli, plan_file: Path, tmp_path: Path) -> None:
    outcome = cli("setpoints", plan_file, "--rate", "2", "--format", "tlog", "--autopilot", "ardupilot",
                  "--launch", "2026-11-22T09:00:00Z", "-o", tmp_path / "p.tlog")  # fmt: skip
    assert (outcome.code, outcome.out) == (0, "")
    data = (tmp_path / "p.tlog").read_bytes()
    assert int.from_bytes(data[:8], "big") == 1_795_338_000_000_000  # 2026-11-22T09:00:00Z in microseconds
    assert data[8] == 0xFD


@pytest.mark.parametrize("rate", ["0", "-1", "201", "nan", "inf"])
def test_a_rate_out_of_range_is_told(cli: Cli, plan_file: Path, rate: str) -> None:
    outcome = cli("setpoints", plan_file, "--rate", rate)
    assert (outcome.code, outcome.out) == (2, "")
    assert "0.1 to 200" in outcome.err


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_fault(plan_file: Path) -> None:
    command = subprocess.Popen(
        [*SKYRELAY, "setpoints", str(plan_file), "--rate", "50"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert command.stdout is not None
    assert command.stderr is not None
    assert command.stdout.readline().startswith(b"time_s")
    command.stdout.close()
    said = command.stderr.read()
    command.wait(30)
    command.stderr.close()
    assert said == b""


# -- fly, before anything flies ---------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--link", "den-helder=udpout:127.0.0.1:9"], "texel"),
        (["--link", "udp:127.0.0.1:9"], "udpout:HOST:PORT"),
        (["--link", "atlantis=udpout:127.0.0.1:9"], "atlantis"),
        (["--link", "texel=nonsense"], "nonsense"),
        (["--link", "udpout:127.0.0.1:9", "--rate", "1000"], "rate_hz"),
        (["--link", "udpout:127.0.0.1:9", "--speedup", "0"], "speedup"),
        (["--link", "udpout:192.0.2.1:9", "--speedup", "10"], "speed-up"),
        (["--link", "udpout:192.0.2.1:9"], "signed"),
        (["--link", "udpout:127.0.0.1:9", "--signing-key", "0123456789abcdef"], "signing_key"),
        (["--link", "serial:/dev/no-such-device:57600"], "no-such-device"),
    ],
)
def test_a_flight_that_must_not_start_is_bad_input(cli: Cli, plan_file: Path, arguments: list[str], said: str) -> None:
    outcome = cli("fly", plan_file, "--autopilot", "px4", *arguments)
    assert (outcome.code, outcome.out) == (2, "")
    assert said in outcome.err
    assert "0123456789abcdef" not in outcome.err  # a key never shows


def test_the_papers_plan_is_not_for_flying(cli: Cli, tmp_path: Path) -> None:
    """Without overlap and margin a plan is optimal and not flyable: the flight is refused, with what to plan."""
    mission = resources.files("sitl_fixtures").joinpath("missions", "paper_like", "M30_01.json").read_bytes()
    papers = [f"--option={name}=0" for name in ("min_overlap_s", "range_margin_m", "min_tenure_s")]
    (tmp_path / "plan.json").write_text(cli("plan", "-", "--json", *papers, stdin=mission).out)
    outcome = cli("fly", tmp_path / "plan.json", "--autopilot", "px4", "--link", "udpout:127.0.0.1:9")
    assert (outcome.code, outcome.out) == (2, "")
    assert "range_margin_m" in outcome.err
    assert "min_overlap_s" in outcome.err


# -- report -----------------------------------------------------------------------------------------------------------


def test_a_log_that_holds_no_flight_is_told(cli: Cli, plan_file: Path, tmp_path: Path) -> None:
    (tmp_path / "noise.tlog").write_bytes(b"no telemetry" * 100)
    for log in (tmp_path / "noise.tlog", tmp_path / "missing.tlog", tmp_path):
        outcome = cli("report", log, plan_file)
        assert (outcome.code, outcome.out) == (2, ""), outcome
        assert "Traceback" not in outcome.err
