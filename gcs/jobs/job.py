"""One thing to plan, on its way through the planning processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from gcs.errors import InputFault, MissionError, infeasible_from_document

Progress = Callable[[str, float], None]


@dataclass(eq=False)
class Job:
    """A mission, or a flight to replan, handed to the planners; ``future`` gets the plan document or the error."""

    number: int
    task: Mapping[str, Any]
    method: str | None
    limit_s: float
    on_progress: Progress | None
    future: Future[dict[str, Any]] = field(default_factory=Future)
    notes: list[str] = field(default_factory=list)
    attempts: int = 0
    cancelled: bool = False

    @property
    def message(self) -> dict[str, Any]:
        """The task for `gcs.jobs.planning_process.plan`."""
        return {"number": self.number, **self.task, "method": self.method, "notes": list(self.notes)}

    def settle(self, answer: Mapping[str, Any]) -> None:
        """End it with what `gcs.jobs.planning_process.plan` said of it."""
        if "infeasible" in answer:
            self.fail(infeasible_from_document(answer["infeasible"]))
        elif "malformed" in answer:
            self.fail(MissionError([InputFault(**fault) for fault in answer["malformed"]]))
        elif not self.future.done():
            self.future.set_result(answer["plan"])

    def fail(self, error: Exception) -> None:
        """End it with an error."""
        if not self.future.done():
            self.future.set_exception(error)
