"""Proposals of new plans: judged by the rules of a launch, kept with the flight, found after a restart."""

from __future__ import annotations

import json
from concurrent.futures import Future
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest

from api.service import ReplanError, ReplanInfeasibleError, ReplanStateError, StillStoppingError
from api.service.flights import FlightService
from api.service.replanning import Replanning
from gcs.errors import MissionInfeasible, NotFoundError
from gcs.plan.model import Plan
from gcs.planning.replanning import replan
from link.director.plan_exchange import judge_next
from link.preflight.check import Level
from link.session.request import FlightRequest
from tests.support.plans.planned import relay_plan, wide_plan

OLD = wide_plan()


def request_of(plan: Plan, **more: Any) -> FlightRequest:
    links = dict.fromkeys(plan.station_ids, "udpout:127.0.0.1:9")
    return FlightRequest(plan=plan.to_document(), autopilot="px4", links=links, **more)


class Running:
    """A flight in cruise, 5 s into its plan; notes the plans it is given."""

    result = None

    def __init__(self) -> None:
        self.given: list[tuple[str, dict[str, Any]]] = []

    def status(self) -> dict[str, Any]:
        return {"state": "cruise", "plan_s": 5.0, "t_plus_s": 7.0, "stands": False, "handovers_done": 0,
                "plan_sha256": OLD.plan_sha256, "loss_timeout_s": 1.0}  # fmt: skip

    def replan(self, document: dict[str, Any], **fields: Any) -> None:
        self.given.append((document["plan_sha256"], fields))


class Pool:
    """Plans at once, in this process."""

    def replan(self, order: Any, *, limit_s: float) -> Future[dict[str, Any]]:
        made = replan(OLD, order.join_s, method="fast")
        done: Future[dict[str, Any]] = Future()
        done.set_result(
            {"plan": made.plan.to_document(), "join_s": made.join_s, "leave_s": made.leave_s, "at_rest": made.at_rest}
        )
        return done


def service(run_dir: Path, running: Running) -> Replanning:
    """One that has just started and found the flight."""
    store = SimpleNamespace(flights=SimpleNamespace(get=lambda _: SimpleNamespace(document={"run_dir": str(run_dir)})))
    settings = SimpleNamespace(data_dir=run_dir / "data")
    flights = FlightService(settings, store, None)  # type: ignore[arg-type]
    flights._watched["f"] = SimpleNamespace(flight=running)  # type: ignore[assignment]
    return Replanning(flights, Pool())  # type: ignore[arg-type]


def test_a_proposal_outlives_the_service_and_is_judged_like_a_launch(tmp_path: Path) -> None:
    (tmp_path / "request.json").write_text(json.dumps(request_of(OLD).to_document()))
    running = Running()
    proposal = service(tmp_path, running).propose("f", lambda _: OLD.to_document())
    told = proposal.to_document()
    assert [check["name"] for check in told["checks"]] == ["handovers"]
    assert told["checks"][0]["level"] == "pass"
    again = service(tmp_path, running)
    again.accept("f", told["plan_sha256"], by="me", reason="")
    assert running.given == [(told["plan_sha256"], {"by": "me", "reason": ""})]
    with pytest.raises(NotFoundError, match="no plan 00 is proposed to flight f: ask for one and accept that"):
        again.accept("f", "00", by="me", reason="")


@pytest.mark.parametrize(
    ("status", "refusal", "said"),
    [
        ({"state": "landing"}, ReplanStateError, "a flight that is landing cannot be replanned"),
        ({"state": "holding", "plan_s": None}, ReplanStateError, "it must cruise or hold on its path"),
        ({"state": "holding", "stands": False}, StillStoppingError, "ask again when it stands"),
    ],
)
def test_a_flight_that_cannot_be_replanned_now_says_so(
    tmp_path: Path, status: dict[str, Any], refusal: type[ReplanError], said: str
) -> None:
    running = Running()
    running.status = lambda: {**Running.status(running), **status}  # type: ignore[method-assign]
    with pytest.raises(refusal, match=said):
        service(tmp_path, running).propose("f", lambda _: OLD.to_document())


def test_a_flight_nothing_goes_on_from_says_why(tmp_path: Path) -> None:
    class Infeasible(Pool):
        joins: ClassVar[list[float]] = []

        def replan(self, order: Any, *, limit_s: float) -> Future[dict[str, Any]]:
            self.joins.append(order.join_s)
            done: Future[dict[str, Any]] = Future()
            done.set_exception(MissionInfeasible("join" if len(self.joins) == 1 else "range", "No way on."))
            return done

    proposals = service(tmp_path, Running())
    proposals._pool = Infeasible()  # type: ignore[assignment]
    with pytest.raises(ReplanInfeasibleError, match="No way on") as refusal:
        proposals.propose("f", lambda _: OLD.to_document())
    # A join inside a handover is tried again 6 s later; what no moment mends is not, and the first reason is told.
    assert Infeasible.joins == [35.0, 41.0]
    assert refusal.value.finding.reason == "join"


def test_of_a_flights_proposals_the_last_twenty_are_kept(tmp_path: Path) -> None:
    flights = service(tmp_path, Running())._flights
    for number in range(23):
        flights.keep_proposal("f", {"plan": {"plan_sha256": f"{number:02d}"}})
    for number in range(3):
        with pytest.raises(NotFoundError):
            flights.proposal("f", f"{number:02d}")
    assert [flights.proposal("f", f"{number:02d}")["plan"]["plan_sha256"] for number in (3, 22)] == ["03", "22"]


def test_handovers_that_are_behind_are_judged_no_more() -> None:
    plan = relay_plan(3)
    first, second = plan.handovers
    # An autopilot that waits for minutes: a failure is noticed when it is too late to stop anywhere.
    request = request_of(plan)

    def found(after_s: float) -> list[tuple[str, Level]]:
        return [(c.name, c.level) for c in judge_next(plan, request, loss_timeout_s=60.0, after_s=after_s)]

    assert found(0.0) == [("handover 1", Level.WARNING), ("handover 2", Level.WARNING)]
    assert found(first.time_s + 1.0) == [("handover 2", Level.WARNING)]
    assert found(second.time_s + 1.0) == []


def test_what_it_will_be_refused_for_is_told_first() -> None:
    plan = relay_plan(2)
    # Plans are refused at the door where the overlaps are too short for the flight's patience.
    patient = request_of(plan)
    object.__setattr__(patient, "confirmation_time_s", 59.0)
    checks = judge_next(plan, patient, loss_timeout_s=1.0, after_s=0.0)
    assert [(c.name, c.level) for c in checks] == [
        ("plan.handovers[1].overlap", Level.FAILURE),
        ("handovers", Level.PASS),
    ]
    assert checks[0].remedy == "plan with min_overlap_s 61 or more"
