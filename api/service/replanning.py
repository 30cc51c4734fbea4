"""Planning a flight anew while it flies: a proposal from its present state, and a person's acceptance of it.

Planning happens in the planning processes; the streamer judges what it is given once more and takes it over between two
ticks (`link.director.plan_exchange`). A proposal costs nothing: the flight goes on as it was until one is accepted. It
is judged by the rules of a launch, and kept with the flight.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from dataclasses import asdict, dataclass
from typing import Any

from api.service.errors import ReplanFailedError, ReplanInfeasibleError, ReplanStateError, StillStoppingError
from api.service.flights import FlightService
from gcs.errors import MissionInfeasible, PlanningCancelled, PlanningFailed
from gcs.flight import FlightState
from gcs.jobs import PlanningPool
from gcs.plan import read_plan
from gcs.planning import ReplanOrder
from link.director import judge_next
from link.errors import SupervisorError

_LIMIT_S = 20.0
# A join that falls into a handover is tried again so much later.
_LATER_S = (0.0, 6.0, 12.0)
# What is accepted later than so long before the join is too late for the streamer.
_NOTICE_S = 1.0
# A streamer that cannot be reached is asked again so often, and so long after.
_ENDING_LOOKS, _ENDING_LOOK_S = 10, 0.1


@dataclass(frozen=True)
class Proposal:
    """A plan offered to a flight; ``decide_by_t_plus_s`` is None for a flight that stands: it may take its time.

    ``checks`` are the findings about it, the worst first: a ``failure`` is what it will be refused for.
    """

    plan: Mapping[str, Any]
    join_s: float
    leave_s: float
    at_rest: bool
    shift_s: float
    decide_by_t_plus_s: float | None
    checks: Sequence[Mapping[str, Any]]

    def to_document(self) -> dict[str, Any]:
        """As `api.rest.schemas.ReplanProposal`."""
        plan = self.plan
        upcoming = [h for h in plan["handovers"] if h["time_s"] > self.join_s]
        return {
            "plan_sha256": plan["plan_sha256"],
            "at_rest": self.at_rest,
            "join_s": self.join_s,
            "decide_by_t_plus_s": self.decide_by_t_plus_s,
            "mission_time_s": plan["mission_time_s"],
            "stations": plan["stations"],
            "handovers": [
                {"index": h["index"], "from": h["from"], "to": h["to"], "t_plus_s": h["time_s"] + self.shift_s}
                for h in upcoming
            ],
            "checks": list(self.checks),
            "plan": plan,
        }


class Replanning:
    """Proposals of all flights."""

    def __init__(self, flights: FlightService, pool: PlanningPool) -> None:
        self._flights = flights
        self._pool = pool

    def propose(
        self,
        flight_id: str,
        plan_of: Callable[[str], Mapping[str, Any]],
        *,
        destination: Mapping[str, float] | None = None,
        excluded_stations: Sequence[str] | None = None,
        ahead_s: float = 30.0,
    ) -> Proposal:
        """Plan on from where the flight stands, or from ``ahead_s`` ahead of it (seconds of the plan).

        ``plan_of`` gives a plan's document by its hash. Raises a `api.service.errors.ReplanError` where the flight
        cannot be replanned now or no plan is found, `gcs.errors.MissionError`, `SupervisorError`.
        """
        status = self._status(flight_id)
        state = FlightState(status["state"])
        if state not in (FlightState.CRUISE, FlightState.HOLDING) or status["plan_s"] is None:
            raise ReplanStateError(f"a flight that is {state} cannot be replanned; it must cruise or hold on its path")
        at_rest = state is FlightState.HOLDING
        if at_rest and not status["stands"]:
            raise StillStoppingError("the flight is coming to a stop; ask again when it stands")
        document = plan_of(status["plan_sha256"])
        shift_s = float(status["t_plus_s"]) - float(status["plan_s"])
        refusal: MissionInfeasible | None = None
        for later_s in (0.0,) if at_rest else _LATER_S:
            join_s = float(status["plan_s"]) + (0.0 if at_rest else ahead_s + later_s)
            order = ReplanOrder(
                plan=document,
                join_s=join_s,
                at_rest=at_rest,
                destination=destination,
                excluded_stations=None if excluded_stations is None else tuple(excluded_stations),
                elapsed_s=join_s + shift_s,
                present_s=float(status["plan_s"]),
                handovers_done=int(status["handovers_done"]),
            )
            try:
                return self._keep(flight_id, self._planned(order), shift_s, float(status["loss_timeout_s"]))
            except MissionInfeasible as error:
                refusal = refusal or error
                if error.reason != "join":
                    break
        assert refusal is not None
        raise ReplanInfeasibleError(refusal)

    def _status(self, flight_id: str) -> dict[str, Any]:
        """What the streamer says; where it cannot be reached it may have ended just now, which is known in a moment."""
        for _ in range(_ENDING_LOOKS):
            with contextlib.suppress(SupervisorError):
                return self._flights.streamer_status(flight_id)
            time.sleep(_ENDING_LOOK_S)
        return self._flights.streamer_status(flight_id)

    def _planned(self, order: ReplanOrder) -> dict[str, Any]:
        try:
            return self._pool.replan(order, limit_s=_LIMIT_S).result(2.0 * _LIMIT_S)
        except (PlanningFailed, PlanningCancelled, FutureTimeoutError, CancelledError) as error:
            raise ReplanFailedError(str(error) or "planning took too long") from None

    def _keep(self, flight_id: str, made: Mapping[str, Any], shift_s: float, loss_timeout_s: float) -> Proposal:
        at_rest, leave_s, join_s = bool(made["at_rest"]), float(made["leave_s"]), float(made["join_s"])
        decide_by_s = None if at_rest else leave_s - _NOTICE_S + shift_s
        # From rest the plan's time moves on by the braking it stands for; the clock does not.
        shift_s += leave_s - join_s
        plan = read_plan(made["plan"])
        checks = judge_next(plan, self._flights.request(flight_id), loss_timeout_s=loss_timeout_s, after_s=join_s)
        told = [check.to_document() for check in checks]
        proposal = Proposal(made["plan"], join_s, leave_s, at_rest, shift_s, decide_by_s, told)
        self._flights.keep_proposal(flight_id, asdict(proposal))
        return proposal

    def accept(self, flight_id: str, plan_sha256: str, *, by: str, reason: str) -> None:
        """An operator command: fly this proposal. Raises `NotFoundError`, and as `FlightService.command` does."""
        proposal = Proposal(**self._flights.proposal(flight_id, plan_sha256))
        times = {"join_s": proposal.join_s, "leave_s": proposal.leave_s} if proposal.at_rest else {}
        self._flights.replan(flight_id, proposal.plan, by=by, reason=reason, **times)
