"""Fixtures of the planner's tests; the functions behind them are in ``tests/support/missions/problems.py``."""

from __future__ import annotations

import pytest

from planner import Problem
from tests.support.missions.problems import PAPER_LIKE, make_problem, paper_problem


@pytest.fixture(params=PAPER_LIKE)
def mission_name(request: pytest.FixtureRequest) -> str:
    """Each of the 30 paper-like missions in turn."""
    return str(request.param)


@pytest.fixture
def small_problem() -> Problem:
    """M30_01, the paper's problem (no overlap, no margin, no tenure)."""
    return paper_problem("M30_01")


@pytest.fixture
def two_stations() -> Problem:
    """Two equal ranges on the ground, 1,600 m apart, whose discs at 100 m overlap by about 390 m.

    ``(0, 0)`` start ── A(0, 0) ── B(1600, 0) ── destination ``(1600, 0)``, all at 100 m, range 1,000 m.
    """
    return make_problem([0, 0, 100], [1600, 0, 100], [[0, 0, 0, 1000], [1600, 0, 0, 1000]])
