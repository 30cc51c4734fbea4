"""Scorecard 40: whatever happened to a log, its report is made, tells the damage, and is not moved by it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

from link.files.flight_report import FlightReport, report_flight
from tests.scorecard.soak import counted
from tests.support.flights.recorded import damaged, plan, recorded

BOTH = pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])


def wrong(whole: FlightReport, log: bytes, seed: int, folder: Path) -> tuple[str, list[str]]:
    """What was done to a log, and what is not right about its report."""
    kind, data = damaged(log, seed)
    path = folder / "damaged.tlog"
    path.write_bytes(data)
    report = report_flight(path, plan())
    problems = [] if report.damage.lines else ["not told"]
    assert report.tracking_worst_m is not None
    assert whole.tracking_worst_m is not None
    if report.tracking_worst_m > whole.tracking_worst_m + 1.0:
        problems.append(f"tracking {report.tracking_worst_m:.2f} m instead of {whole.tracking_worst_m:.2f}")
    if report.longest_gap_s > whole.longest_gap_s + 0.1:
        problems.append(f"a gap of {report.longest_gap_s:.2f} s")
    # A log cut while the vehicle lands holds the whole plan.
    whole_plan = kind != "cut" or abs(report.flown_s - whole.flown_s) <= 0.1
    if report.reached is not whole_plan:
        problems.append("the end is told wrongly")
    if abs(report.flown_s - whole.flown_s) > 0.5 and kind != "cut":
        problems.append(f"{report.flown_s:.2f} s flown instead of {whole.flown_s:.2f}")
    assert report.to_text()
    return kind, [f"seed {seed}, {kind}: {p}" for p in problems]


def judged(autopilot: str, seeds: range, folder: Path) -> tuple[Counter[str], list[str]]:
    log = recorded(autopilot, 1)
    path = folder / "whole.tlog"
    path.write_bytes(log)
    whole = report_flight(path, plan())
    assert whole.damage.lines == ()
    assert whole.not_planned == ()
    done: Counter[str] = Counter()
    problems: list[str] = []
    for seed in counted(f"logs {autopilot}", seeds):
        kind, found = wrong(whole, log, seed, folder)
        done[kind] += 1
        problems += found
    return done, problems


@pytest.mark.slow
@BOTH
def test_damage_of_every_kind_is_told_and_moves_no_figure(autopilot: str, tmp_path: Path) -> None:
    done, problems = judged(autopilot, range(12), tmp_path)
    assert problems == []
    assert len(done) == 6


@pytest.mark.soak
@BOTH
def test_three_hundred_damaged_logs(autopilot: str, tmp_path: Path) -> None:
    done, problems = judged(autopilot, range(100, 400), tmp_path)
    assert problems == []
    print(dict(done))
