"""Why a flight stands on its path, and what it goes on with."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from gcs.flight import FlightState


class HoldReason(Enum):
    """Why a flight stands; the value is what people are told."""

    COMMANDED = "word"
    """An operator said so."""
    NEXT_PLAN = "a new plan"
    """Another plan begins at rest here, or a little way back."""
    BLIND = "the vehicle's position is not heard"
    NOT_FOLLOWING = "the vehicle does not follow"
    STATION_NOT_READY = "waiting"
    """The handover ahead cannot be made yet."""
    NOT_AUTHORISED = "authorised"
    """The flight has come as far as it may."""


@dataclass(frozen=True, slots=True)
class Hold:
    """A flight that stands. ``resumes`` is the state it goes on in, ``detail`` the reason in more words."""

    reason: HoldReason
    resumes: FlightState
    detail: str = ""

    @property
    def text(self) -> str:
        """For people."""
        return self.detail or self.reason.value
