"""What both demonstrations have in common: what they say, how fast they fly, and what they do when that was too fast.

`api.cli.demo.command` tells the story in one process, `api.cli.demo.through_service` through the service; neither
knows the other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import typer

if TYPE_CHECKING:
    from gcs.plan import Plan

__all__ = ["AUTOPILOT", "FLIGHT_WALL_S", "QUICK_WALL_S", "Pace", "closing", "fly_until_arrival", "say"]

Outcome = TypeVar("Outcome")

AUTOPILOT = "ardupilot"
"""Which autopilot model is flown."""
FLIGHT_WALL_S = 70.0
"""Wall seconds the flight should take, take-off and landing included."""
QUICK_WALL_S = 12.0
"""The same of the short mission."""
_ATTEMPTS = 3
_GROUND_S = 120.0  # climb, descent and checks, in seconds of the vehicle
_MAX_SPEEDUP = 100.0
# Setpoints a wall second the machine is asked for at most, whatever the speed-up.
_WALL_RATE_HZ = 800.0


@dataclass(frozen=True)
class Pace:
    """How fast a demonstration flies (times real time), and how often it sends (setpoints a vehicle's second)."""

    speedup: float
    rate_hz: float

    @classmethod
    def of(cls, mission_time_s: float, wall_s: float) -> Pace:
        """The pace at which the flight takes about ``wall_s``; never slower than real time."""
        return cls.at(min(_MAX_SPEEDUP, max(1.0, (mission_time_s + _GROUND_S) / wall_s)))

    @classmethod
    def at(cls, speedup: float) -> Pace:
        """A pace by its speed-up: 20 setpoints a second of the vehicle's, fewer where the machine could not."""
        return cls(speedup, float(max(5, min(20, int(_WALL_RATE_HZ / speedup)))))

    def slower(self) -> Pace:
        """Half as fast."""
        return self.at(max(1.0, self.speedup / 2.0))


def fly_until_arrival(pace: Pace, fly: Callable[[Pace, int], Outcome], arrived: Callable[[Outcome], bool]) -> Outcome:
    """``fly(pace, attempt)``, and again half as fast where that did not arrive: the last outcome.

    A machine too busy for the pace is the one thing that can go wrong here; three attempts, none
    slower than real time.
    """
    for attempt in range(1, _ATTEMPTS + 1):
        outcome = fly(pace, attempt)
        if arrived(outcome) or attempt == _ATTEMPTS or pace.speedup <= 1.0:
            break
        say(
            f"\nAt {pace.speedup:.0f} times real speed this machine was too busy to keep up, and the flight ended "
            "safely instead. Once more, half as fast."
        )
        pace = pace.slower()
    return outcome


def say(text: str = "") -> None:
    """A line of the story, at once."""
    typer.echo(text)


def closing(plan: Plan) -> str:
    """How it goes on from here."""
    count = len(plan.handovers)
    return (
        f"{count} handover{'' if count == 1 else 's'}, never without a station in range. Next: skyrelay demo --serve, "
        "skyrelay plan MISSION.json -o PLAN.json, skyrelay --help."
    )
