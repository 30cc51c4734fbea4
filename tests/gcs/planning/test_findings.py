"""Planning raises findings and looks for nothing that would help; what would is asked once, at the end."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from gcs.errors import Finding, MissionInfeasible, PlanningFailed
from gcs.layout.findings import NoAirspeed, NoRangeLeft
from gcs.layout.problem_planner import ProblemPlanner
from gcs.mission import read_mission, with_options
from gcs.planning import mission_planning, plan_mission, recertify
from gcs.planning.mission_planning import PlanningMethod, find_plan
from gcs.remedies.findings import ArrivalAfterEndurance, ArrivalTooEarly, EnduranceTooShort, NoTrajectory
from planner import Planner, Problem, Solution
from tests.support.missions.infeasible import local
from tests.support.missions.malformed import GOOD_LOCAL


class CountingPlanner:
    """A planner that counts what it is asked."""

    def __init__(self) -> None:
        self.asked = 0
        self._planner = Planner()

    def plan(self, problem: Problem, **how: Any) -> Solution:
        self.asked += 1
        return self._planner.plan(problem, **how)


FOUND: list[tuple[dict[str, Any], type[Finding], int]] = [
    (local(options__range_margin_m=5000.0), NoRangeLeft, 0),
    (local(limits__max_airspeed_m_s=15.0, limits__wind={"east_m_s": 12.0, "north_m_s": 9.5}), NoAirspeed, 0),
    (local(limits__endurance_s=100.0, limits__reserve_s=40.0, options__arrival_s=70.0), ArrivalAfterEndurance, 0),
    (local(start__east_m=-1200.0), NoTrajectory, 1),
    (local(limits__endurance_s=45.0, limits__reserve_s=10.0), EnduranceTooShort, 1),
    (local(options__arrival_s=30.0), ArrivalTooEarly, 1),
    (local(options__start_state={"velocity_m_s": [70.0, 0.0, 0.0]}), NoTrajectory, 1),
]


@pytest.mark.parametrize(("document", "kind", "plans"), FOUND, ids=[kind.__name__ for _, kind, _ in FOUND])
def test_a_finding_costs_no_search(document: dict[str, Any], kind: type[Finding], plans: int) -> None:
    planner = CountingPlanner()
    with pytest.raises(kind):
        find_plan(read_mission(document), PlanningMethod(ProblemPlanner(planner, "fast")))
    assert planner.asked == plans


def test_it_is_explained_once(monkeypatch: pytest.MonkeyPatch) -> None:
    explained: list[Finding] = []

    def explain(finding: Finding, planner: object) -> MissionInfeasible:
        explained.append(finding)
        return MissionInfeasible("limits", "As found.")

    monkeypatch.setattr(mission_planning, "explain", explain)
    planner = CountingPlanner()
    with pytest.raises(MissionInfeasible, match=r"As found\.") as raised:
        plan_mission(read_mission(local(limits__endurance_s=45.0, limits__reserve_s=10.0)), fast=True, planner=planner)
    (finding,) = explained
    assert raised.value.__cause__ is finding
    assert planner.asked == 1


def test_a_plan_of_a_mission_nobody_can_fly_is_no_plan() -> None:
    plan = plan_mission(read_mission(GOOD_LOCAL), fast=True)
    assert recertify(plan).feasible
    stripped = replace(plan, mission=with_options(plan.mission, {"range_margin_m": 400_000.0}))
    with pytest.raises(PlanningFailed, match="leaves no station any range"):
        recertify(stripped)
