"""The schedule as people and programs get it."""

from __future__ import annotations

import csv
import io
import json
import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from gcs.errors import ExportError
from gcs.exports.handovers import CSV_HEADER, export_handovers, parse_launch, watches, write_atomic
from gcs.exports.plan_summary import summary
from gcs.mission import read_mission
from gcs.mission.staffing import staffed
from gcs.plan.model import Plan
from gcs.planning.mission_planning import plan_mission
from tests.support.missions.malformed import GOOD

LAUNCH = datetime(2026, 11, 22, 9, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def plan() -> Plan:
    stations = [
        {**GOOD["stations"][0], "name": 'Den Helder "airfield", south', "contact": "+31 000", "radio_channel": "C2-4"},
        {**GOOD["stations"][1], "hours": "08:00-09:05"},
    ]
    return plan_mission(read_mission({**GOOD, "stations": stations}), fast=True)


def test_csv_is_the_contract_s(plan: Plan) -> None:
    text = export_handovers(plan, "csv", launch=LAUNCH)
    assert text.startswith(
        "index,time_s,time_utc,from,to,lat_deg,lon_deg,alt_amsl_m,speed_m_s,course_deg,"
        "overlap_start_s,overlap_end_s,margin_from_m,margin_to_m\r\n"
    )
    assert text.endswith("\r\n")
    (row,) = csv.DictReader(io.StringIO(text))
    handover = plan.handovers[0]
    assert tuple(row) == CSV_HEADER
    assert float(row["time_s"]) == handover.time_s
    assert float(row["margin_to_m"]) == handover.margin_to_m
    assert (row["from"], row["to"]) == ("den-helder", "texel")
    moment = datetime.fromisoformat(row["time_utc"])
    assert abs((moment - LAUNCH).total_seconds() - handover.time_s) < 1e-3
    assert next(csv.DictReader(io.StringIO(export_handovers(plan, "csv"))))["time_utc"] == ""


def test_json_carries_everything_unrounded(plan: Plan) -> None:
    document = json.loads(export_handovers(plan, "json", launch=LAUNCH))
    assert document["plan_sha256"] == plan.plan_sha256
    assert document["launch_utc"] == "2026-11-22T09:00:00.000Z"
    (handover,) = document["handovers"]
    assert {key: handover[key] for key in plan.handovers[0].to_document()} == plan.handovers[0].to_document()
    first, second = document["in_control"]
    assert (first["start_s"], first["end_s"]) == (0.0, plan.handovers[0].time_s)
    assert second["end_s"] == plan.mission_time_s
    assert first["staffed"] is None
    # texel's people leave at 09:05, the flight arrives after 09:12
    assert second["staffed"] is False


def test_table_for_people(plan: Plan) -> None:
    text = export_handovers(plan, "table", launch=LAUNCH)
    lines = text.splitlines()
    assert lines[0] == "Den Helder to Texel"
    row = next(line for line in lines if line.startswith("1 "))
    t = round(plan.handovers[0].time_s)
    assert f"0:{t // 60:02d}:{t % 60:02d}" in row
    assert (LAUNCH + timedelta(seconds=t)).strftime("%H:%M:%S") in row
    assert "NOT STAFFED THEN" in text
    assert "C2-4" in text
    assert "+31 000" in text
    assert "UTC" not in export_handovers(plan, "table").splitlines()[3]


def test_one_station_s_part(plan: Plan) -> None:
    assert len(watches(plan, "texel")) == 1
    assert "the part of texel" in export_handovers(plan, "table", station="texel")
    document = json.loads(export_handovers(plan, "json", station="texel"))
    assert [w["station"] for w in document["in_control"]] == ["texel"]
    with pytest.raises(ExportError, match="no station 'nowhere'; this plan uses den-helder, texel"):
        export_handovers(plan, "csv", station="nowhere")


def test_a_station_that_is_not_used_is_told_so() -> None:
    document = {**GOOD, "destination": {**GOOD["start"], "lat_deg": 52.93}}
    alone = plan_mission(read_mission(document), fast=True)
    assert "does not use texel" in export_handovers(alone, "table", station="texel")
    assert "one station is in control all the way" in export_handovers(alone, "table")
    assert export_handovers(alone, "csv").count("\r\n") == 1


def test_bad_requests_are_refused(plan: Plan) -> None:
    with pytest.raises(ExportError, match="choose one of table, json, csv"):
        export_handovers(plan, "pdf")
    for text in ("tomorrow", "2026-11-22T09:00:00", "2026-13-01T00:00:00Z", ""):
        with pytest.raises(ExportError, match="RFC 3339"):
            parse_launch(text)
    assert parse_launch("2026-11-22T10:00:00+01:00") == LAUNCH
    with pytest.raises(ExportError, match="out of range"):
        export_handovers(plan, "csv", launch=datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC))


def test_summary_names_what_matters(plan: Plan) -> None:
    text = summary(plan)
    for part in (
        "Den Helder to Texel",
        "which no flight can beat",
        "den-helder > texel",
        "handover 1",
        plan.plan_sha256,
    ):
        assert part in text


@pytest.mark.parametrize(
    ("hours", "clock", "there"),
    [
        ("08:00-18:00", "09:00", True),
        ("08:00-18:00", "18:00", False),
        ("08:00-12:00, 13:00-17:00 UTC", "12:30", False),
        ("22:00-06:00", "23:30", True),
        ("22:00-06:00", "05:59", True),
        ("22:00-06:00", "12:00", False),
        ("24/7", "03:00", True),
        ("00:00-24:00", "23:59", True),
        ("weekdays", "09:00", None),
        ("08:00-18:00, sometimes", "09:00", None),
        ("08:00-24:30", "09:00", None),
        (None, "09:00", None),
    ],
)
def test_hours(hours: str | None, clock: str, there: bool | None) -> None:
    moment = datetime.fromisoformat(f"2026-11-22T{clock}:00+00:00")
    assert staffed(hours, moment) is there


def test_files_are_written_whole_or_not_at_all(tmp_path: Path, plan: Plan) -> None:
    target = tmp_path / "schedule.csv"
    target.write_text("old")
    text = export_handovers(plan, "csv")
    write_atomic(target, text)
    assert target.read_bytes() == text.encode()
    assert stat.S_IMODE(target.stat().st_mode) & 0o400
    assert os.listdir(tmp_path) == ["schedule.csv"]
    with pytest.raises(OSError):
        write_atomic(tmp_path / "missing" / "x.csv", text)
    folder = tmp_path / "folder"
    folder.mkdir()
    with pytest.raises(OSError):
        write_atomic(folder, text)  # the rename fails: nothing is left behind
    assert sorted(os.listdir(tmp_path)) == ["folder", "schedule.csv"]
