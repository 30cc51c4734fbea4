"""Scorecard 14: every fault of the table ends as it must, on both autopilots; ``docs/faults.md`` is that table."""

from __future__ import annotations

import pytest

import tests.scorecard.fault_outcomes as table
from sitl_fixtures.faults import FAULTS

BOTH = pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
SAMPLE = (
    "link-cut:0@T22+1000",
    "telemetry-reordered",
    "frames-littered",
    "ack-repeated",
    "mode-without-effect",
    "uplink-loss",
    "uplink-loss-share",
    "foreign-station-returns",
    "net-bad",
    "net-dead-in-flight",
)


def test_every_fault_of_the_simulator_has_an_outcome_and_there_are_ninety_and_more() -> None:
    assert {row.name for row in table.ROWS} == set(FAULTS)
    assert {row.name for row in table.NETWORK_ROWS} == set(table.NETWORK)
    specifications = [row.specification for row in table.all_rows()]
    assert len(specifications) == len(set(specifications)) >= 90


def test_the_page_is_the_table() -> None:
    text = table.PAGE.read_text(encoding="utf-8")
    assert text == table.page(), "run `python -m tests.scorecard.fault_outcomes > docs/faults.md`"


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize(
    "row", [r for r in table.all_rows() if r.specification in SAMPLE], ids=lambda r: r.specification
)
def test_a_sample_of_the_faults_ends_as_it_must(row: table.Row, autopilot: str) -> None:
    assert table.judge(row, autopilot, table.fly(row, autopilot)) == []


@BOTH
@pytest.mark.soak
@pytest.mark.parametrize("row", table.all_rows(), ids=lambda r: r.specification)
def test_every_fault_ends_as_it_must(row: table.Row, autopilot: str) -> None:
    assert table.judge(row, autopilot, table.fly(row, autopilot)) == []
