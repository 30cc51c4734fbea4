"""Errors of the domain as the problems they mean to the outside."""

from __future__ import annotations

from typing import Any

import pytest

from api.rest.routes.shared import api_error_of
from api.service import ReplanFailedError, ReplanInfeasibleError, ReplanStateError, ServiceError, StillStoppingError
from gcs.errors import MissionInfeasible

GAP = MissionInfeasible(
    "broken_chain", "There is a gap.", stations=["a", "b"], gap_m=12.5, fix={"action": "raise_range"}, fix_text="Raise."
)


@pytest.mark.parametrize(
    ("error", "kind", "detail", "more"),
    [
        (ReplanStateError("a flight that is landing"), "conflict", "a flight that is landing", {}),
        (StillStoppingError("ask again"), "not-now", "ask again", {}),
        (ReplanFailedError("planning took too long"), "planning-failed", "planning took too long", {}),
        (
            ReplanInfeasibleError(GAP),
            "infeasible",
            "There is a gap. Raise.",
            {"reason": "broken_chain", "stations": ["a", "b"], "gap_m": 12.5, "fix": {"action": "raise_range"}},
        ),
    ],
)
def test_a_refused_replan_is_a_conflict_that_says_why(
    error: ServiceError, kind: str, detail: str, more: dict[str, Any]
) -> None:
    problem = api_error_of(error)
    assert problem is not None
    assert (problem.status, problem.problem_kind, problem.detail, problem.more) == (409, kind, detail, more)


def test_what_nobody_expects_is_no_problem_of_the_callers() -> None:
    assert api_error_of(RuntimeError("a fault of ours")) is None
