"""What both demonstrations tell and how fast they fly."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from gcs.plan import Plan


AUTOPILOT = "ardupilot"
# Wall seconds the flight should take, take-off and landing included.
FLIGHT_WALL_S = 70.0
QUICK_WALL_S = 12.0
_GROUND_S = 120.0  # climb, descent and checks, in seconds of the vehicle
_MAX_SPEEDUP = 100.0
ATTEMPTS = 3
# Setpoints a wall second the machine is asked for at most, whatever the speed-up.
_WALL_RATE_HZ = 800.0


@dataclass(frozen=True)
class Pace:
    """How fast a demonstration flies, and how often it sends."""

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


def say(text: str = "") -> None:
    """A line of the story, at once."""
    typer.echo(text)


def too_fast(pace: Pace) -> str:
    """Why it is flown once more."""
    return (
        f"At {pace.speedup:.0f} times real speed this machine was too busy to keep up, and the flight ended safely "
        "instead. Once more, half as fast."
    )


def closing(plan: Plan) -> str:
    """How it goes on from here."""
    count = len(plan.handovers)
    return (
        f"{count} handover{'' if count == 1 else 's'}, never without a station in range. Next: skyrelay demo --serve, "
        "skyrelay plan MISSION.json -o PLAN.json, skyrelay --help."
    )


def environment() -> dict[str, str]:
    """The environment of programs started beside the demonstration: as it is, without our own settings."""
    return {name: value for name, value in os.environ.items() if not name.startswith("SKYRELAY_")}
