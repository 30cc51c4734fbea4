"""What the service behind REST refuses, in the domain's own terms; `api.rest.routes.shared` says each as a problem.

ServiceError
└── ReplanError             a flight is not given another plan
    ├── ReplanStateError        its state allows none: it must cruise, or hold on its path
    ├── StillStoppingError      not just now: it is coming to a stop; ask again when it stands
    ├── ReplanInfeasibleError   no flight goes on from here as asked: ``finding`` says why, where and what would help
    └── ReplanFailedError       the planner gave up, was stopped, or took too long
"""

from __future__ import annotations

from gcs.errors import MissionInfeasible


class ServiceError(Exception):
    """Base of what the service refuses on purpose."""


class ReplanError(ServiceError):
    """A flight is not given another plan."""


class ReplanStateError(ReplanError):
    """The flight's state allows no other plan."""


class StillStoppingError(ReplanError):
    """The flight is coming to a stop; where it will stand is not known yet."""


class ReplanInfeasibleError(ReplanError):
    """No flight goes on from here as asked. ``finding`` is the planning side's."""

    def __init__(self, finding: MissionInfeasible) -> None:
        super().__init__(str(finding))
        self.finding = finding


class ReplanFailedError(ReplanError):
    """Planning on did not come to an end."""
