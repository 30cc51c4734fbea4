"""Flights: launching them, commanding them in flight, and how they stand."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from api.rest.schemas.base import Closed, Text, Whole


class NewFlight(Closed):
    """Which plan is to be flown by which vehicle."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "mission_id": "0b6f3c1e8e0f4c0d9b1f2a3c4d5e6f70",
                    "plan_sha256": "9d16bbfe1563bb52c3dda9d9af87dbbe40beb98733fe982f8da0e0fefccdfe26",
                    "vehicle_id": "medic-1",
                }
            ]
        },
    )

    mission_id: Text = Field(max_length=64)
    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="Of the plan that is meant: another is refused.")
    vehicle_id: Text = Field(max_length=64)
    version: Whole | None = Field(None, ge=1, le=2**31 - 1, description="Of the mission; default the latest.")
    rate_hz: float | None = Field(None, ge=5, le=100, description="Setpoints a second; default 20.")
    speedup: float | None = Field(None, ge=0.1, le=1000, description="Our simulator at this factor, on loopback alone.")
    operator_words: bool | None = Field(None, description="Each handover waits for the receiving station's `ready`.")
    rally: bool | None = Field(
        None, description="Upload the mission's safe points as rally points for the flight; default true."
    )
    fence: bool | None = Field(
        None, description="Lay a geofence around the plan and every straight way home, for the flight; default false."
    )
    handover_way: Literal["auto", "gate", "range", "parameter", "operator_control"] | None = Field(
        None,
        description="How the vehicle is told of a handover; default `auto`: by what it offers. `parameter`: ArduPilot "
        "hears one station at a time and is told of each.",
    )
    rescue: bool | None = Field(
        None,
        description="Take over an ArduPilot that is locked to other stations' ids, by its own id; default false. It "
        "gets them back after the flight.",
    )


class LaunchCommand(Closed):
    """The launch command."""

    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    preflight_id: Whole = Field(ge=0, le=2**31 - 1, description="`preflight.id` of the flight.")
    by: Text | None = Field(None, max_length=100, description="Who gives it, for the record.")


class CommandBody(Closed):
    """Who gives an operator command, and why; both for the record."""

    by: Text | None = Field(None, max_length=100)
    reason: Text | None = Field(None, max_length=500)


class ReplanRequest(CommandBody):
    """What a new plan from the present state is to be; what is left out stays as it was planned."""

    destination: dict[str, float] | None = Field(None, description="In the mission's frame, as in the mission.")
    excluded_stations: list[Annotated[str, Field(max_length=64)]] | None = Field(
        None, max_length=10_000, description="In place of those excluded so far."
    )
    ahead_s: float = Field(
        30.0, ge=5, le=600, description="How far ahead, in flight, the new plan begins: time to plan, and to decide in."
    )


class ReplanProposal(Closed):
    """A plan the flight could go on by. Nothing has changed until it is accepted.

    ``join_s`` is the time of the new plan from which it is new; it must be accepted before ``decide_by_t_plus_s``
    (null: the flight stands and waits). ``handovers`` are those to come, with the T+ expected. ``checks`` judge it by
    the rules of a launch, the worst first: overlaps, margin, room to stop at each handover to come; it will be refused
    where one is a ``failure``.
    """

    plan_sha256: str
    at_rest: bool
    join_s: float
    decide_by_t_plus_s: float | None
    mission_time_s: float
    stations: list[str]
    handovers: list[dict[str, Any]]
    checks: list[dict[str, Any]]
    plan: dict[str, Any]


class ReplanCommand(CommandBody):
    """Which proposal is accepted."""

    plan_sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class FlightSummary(Closed):
    """A flight, as lists show it. ``state`` is ``preflight`` until the launch command; ``phase`` is finer."""

    id: str
    mission_id: str
    version: Whole
    plan_sha256: str
    vehicle_id: str
    state: str
    phase: str
    created_utc: str
    changed_utc: str
    ended_utc: str | None


class Preflight(Closed):
    """The last preflight: every check with its level, and whether it passed."""

    id: int | None
    passed: bool
    age_s: float | None
    checks: list[dict[str, Any]]


class FlightDetail(FlightSummary):
    """A flight with its preflight, where it is, and how it ended."""

    preflight: Preflight
    live: dict[str, Any]
    handover_states: dict[str, str]
    alarms: list[dict[str, Any]]
    result: dict[str, Any] | None


class FlightPage(Closed):
    """Flights, newest first. ``next`` goes into ``cursor`` for the page after this one; null at the end."""

    items: list[FlightSummary]
    next: str | None


class FlightEvents(Closed):
    """Events in order."""

    items: list[dict[str, Any]]
