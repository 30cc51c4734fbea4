"""What every operator command does in every state of a flight, and when every state ends: two tables.

`effect_of` is what the code that accepts commands goes by (`link.director.core`); ``docs/commands.md`` is printed from
these tables, and each cell is flown in the tests on both autopilot models.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from gcs.flight import FlightState, OperatorCommand, TransitionError


class Effect(StrEnum):
    """What a command does; `EFFECT_TEXTS` has the words."""

    REFUSED = "refused"
    LAUNCH = "launch"
    PREFLIGHT = "preflight"
    STOP_ON_GROUND = "stop on the ground"
    LAND_HERE = "land here"
    LAND_AT_END = "land at the end"
    STOP_CLIMB = "stop the climb"
    GO_ON_LANDING = "go on landing"
    HOLD = "hold"
    KEEP_HOLDING = "keep holding"
    GO_ON = "go on"
    RE_ENTER = "re-enter"
    CONTINGENCY = "contingency"
    GO_ON_RETURNING = "go on returning"
    ABANDON = "abandon"
    LAST_RESORT = "last resort"
    NOTE = "note"
    REPLAN = "replan"


EFFECT_TEXTS: Mapping[Effect, str] = MappingProxyType(
    {
        Effect.REFUSED: "refused, and nothing changes",
        Effect.LAUNCH: "arms and takes off; a preflight of 60 s or more is done again first",
        Effect.PREFLIGHT: "the preflight is made again, and the launch waits for it",
        Effect.STOP_ON_GROUND: "motors off, asked until they are; what was changed on the vehicle is given back; ends",
        Effect.LAND_HERE: "the autopilot's landing mode at once, asked until it shows it, where the vehicle is; ends"
        " `landed` (`contingency` where a contingency was being flown, or the C2 link was lost)",
        Effect.LAND_AT_END: "the autopilot's landing mode at once; ends `completed`",
        Effect.STOP_CLIMB: "the autopilot's landing mode at once, where the vehicle is, before anything else is judged"
        " or sent; ends `contingency`",
        Effect.GO_ON_LANDING: "it lands already and goes on; an abort makes the end a `contingency`",
        Effect.HOLD: "stops on the path and stands",
        Effect.KEEP_HOLDING: "goes on standing, now by command: until the next one while somebody attends",
        Effect.GO_ON: "goes on as before the hold; holds again where its reason still stands",
        Effect.RE_ENTER: "back in: HOLD (PX4), the setpoint mode, a transit to the path in range of a proved station;"
        " else an alarm says why not, and it stays silent",
        Effect.CONTINGENCY: "the contingency procedure in force; held on the way to the plan: a landing",
        Effect.GO_ON_RETURNING: "the contingency procedure is being flown and goes on",
        Effect.ABANDON: "the autopilot's landing mode at once, where the vehicle is; ends `contingency`",
        Effect.LAST_RESORT: "the vehicle is told to return by itself (or to land, as the request says), over the best"
        " link",
        Effect.NOTE: "noted for the handover, or the part of the plan, it names",
        Effect.REPLAN: "the new plan is flown from the moment it was made for, where it fits",
    }
)

_S, _C, _E = FlightState, OperatorCommand, Effect
_GROUND = (_S.CONNECTING, _S.IDENTIFYING, _S.PREFLIGHT, _S.READY)
_OPEN = tuple(state for state in FlightState if not state.ended)

# A state that is not named refuses.
EFFECTS: Mapping[OperatorCommand, Mapping[FlightState, Effect]] = MappingProxyType(
    {
        _C.LAUNCH: {_S.READY: _E.LAUNCH},
        _C.PREFLIGHT: {_S.READY: _E.PREFLIGHT},
        _C.HOLD: {
            _S.TRANSIT: _E.HOLD,
            _S.CRUISE: _E.HOLD,
            _S.RETURNING: _E.HOLD,
            _S.HOLDING: _E.KEEP_HOLDING,
        },
        _C.RESUME: {_S.HOLDING: _E.GO_ON, _S.LAPSED: _E.RE_ENTER},
        _C.ABORT: {
            **dict.fromkeys(_GROUND, _E.STOP_ON_GROUND),
            _S.ARMING: _E.STOP_ON_GROUND,
            _S.TAKEOFF: _E.STOP_CLIMB,
            _S.TRANSIT: _E.ABANDON,
            _S.CRUISE: _E.CONTINGENCY,
            _S.HOLDING: _E.CONTINGENCY,
            _S.RETURNING: _E.GO_ON_RETURNING,
            _S.LAPSED: _E.LAST_RESORT,
            _S.ARRIVED: _E.ABANDON,
            _S.LANDING: _E.GO_ON_LANDING,
        },
        _C.LAND: {
            _S.ARMING: _E.STOP_ON_GROUND,
            **{state: _E.LAND_HERE for state in FlightState if state.airborne},
            _S.ARRIVED: _E.LAND_AT_END,
            _S.LANDING: _E.GO_ON_LANDING,
        },
        _C.READY: dict.fromkeys(_OPEN, _E.NOTE),
        _C.ACCEPT: dict.fromkeys(_OPEN, _E.NOTE),
        _C.REFUSE: dict.fromkeys(_OPEN, _E.NOTE),
        _C.REPLAN: {_S.CRUISE: _E.REPLAN, _S.HOLDING: _E.REPLAN},
        _C.AUTHORISE: dict.fromkeys(_OPEN, _E.NOTE),
    }
)

_INSTEAD: Mapping[FlightState, str] = MappingProxyType(
    {
        **dict.fromkeys(_GROUND, "nothing is armed; 'abort' ends the flight"),
        _S.ARMING: "it is on the ground; 'abort' or 'land' stops it",
        _S.TAKEOFF: "it climbs; 'land' or 'abort' lands it at once",
        _S.LAPSED: "nothing is streamed to it; 'resume', 'land' or 'abort' is what it takes",
        _S.ARRIVED: "it is about to land; 'land' does it now",
        _S.LANDING: "a landing is not undone from here; a pilot can",
    }
)


def effect_of(command: OperatorCommand, state: FlightState) -> Effect:
    """What ``command`` does to a flight that is ``state``."""
    return EFFECTS[command].get(state, Effect.REFUSED)


def refusal(command: OperatorCommand, state: FlightState) -> str:
    """The words of a refusal: what the command needs, what is, what can be commanded instead."""
    allowed = ", ".join(sorted(EFFECTS[command]))
    instead = _INSTEAD.get(state, "")
    return f"'{command}' needs a flight that is {allowed}; this one is {state}" + (f": {instead}" if instead else "")


def check_operator_command(command: OperatorCommand, state: FlightState) -> Effect:
    """What ``command`` does; raises `TransitionError` when it means nothing to a flight that is ``state``."""
    effect = effect_of(command, state)
    if effect is Effect.REFUSED:
        raise TransitionError(refusal(command, state))
    return effect


# -- phases -----------------------------------------------------------------------------------------------------------

DISARM_ASKED_AFTER_S = 30.0
"""On the ground and armed for so long after a landing: the vehicle is asked to disarm."""
GROUND_ARMED_LIMIT_S = 120.0
"""On the ground and armed for so long: the flight ends."""
LANDING_LIMIT_S = 1800.0
LAPSED_LIMIT_S = 3600.0
SETTLE_LIMIT_S = 20.0
STOP_LIMIT_S = 30.0
"""On the ground, told to stop: motors are asked off for so long."""
OVERTIME, OVERTIME_S = 4.0, 600.0
"""A way may take so many times what it should, and so long more, before it is called off."""
TRANSIT_OVERTIME_S = 60.0


def overtime_s(planned_s: float, grace_s: float = OVERTIME_S) -> float:
    """How long a way planned to take ``planned_s`` may take."""
    return OVERTIME * planned_s + grace_s


@dataclass(frozen=True, slots=True)
class PhaseLimit:
    """When a state ends by itself, and how."""

    limit: str
    end: str


PHASES: Mapping[FlightState, PhaseLimit] = MappingProxyType(
    {
        _S.CONNECTING: PhaseLimit("`connect_timeout_s` (30 s), and 8 s for the other links", "refused: no heartbeat"),
        _S.IDENTIFYING: PhaseLimit("`arm_timeout_s` (120 s) for position and origin", "refused: what is missing"),
        _S.PREFLIGHT: PhaseLimit("each question is asked a stated number of times", "ready, or refused: each finding"),
        _S.READY: PhaseLimit("`launch_timeout_s` (3600 s)", "refused: no word to launch"),
        _S.ARMING: PhaseLimit(
            f"5 tries of the mode, `arm_timeout_s` (120 s) to arm; told to stop: {STOP_LIMIT_S:g} s",
            "refused: does not enter the mode, does not arm; lost: does not disarm",
        ),
        _S.TAKEOFF: PhaseLimit(
            "30 s and 2 s a metre (ArduPilot); the climb's own time and 60 s (PX4)", "landing: take-off stuck"
        ),
        _S.TRANSIT: PhaseLimit(
            f"{OVERTIME:g} times its own time and {TRANSIT_OVERTIME_S:g} s; to settle at its end {SETTLE_LIMIT_S:g} s",
            "landing: the transit took too long; not settled: an alarm, then cruise",
        ),
        _S.CRUISE: PhaseLimit(
            f"{OVERTIME:g} times the plan's time and {OVERTIME_S:g} s without a hold",
            "returning: the cruise took too long",
        ),
        _S.HOLDING: PhaseLimit(
            "`hold_limit_s` (300 s); `wait_for_station_s` (60 s) before a station; by command: while somebody attends",
            "returning, or landing: held for so long, and why",
        ),
        _S.RETURNING: PhaseLimit(
            f"{OVERTIME:g} times the plan's time and {OVERTIME_S:g} s; to settle at its end {SETTLE_LIMIT_S:g} s",
            "lapsed with the vehicle told to return by itself; at its end: landing",
        ),
        _S.LAPSED: PhaseLimit(
            "standing in the mode we left it in: `hold_limit_s` (300 s); unheard: `lost_after_s` (120 s); on the"
            f" ground, armed: {GROUND_ARMED_LIMIT_S:g} s; {LAPSED_LIMIT_S:g} s in all",
            "told to return by itself; lost: nothing heard; lost: on the ground, armed, does not disarm; lost: left to"
            " the autopilot",
        ),
        _S.ARRIVED: PhaseLimit(
            f"`arrival_hold_s` (5 s), {SETTLE_LIMIT_S:g} s more to settle; `on_arrival` hold: `hold_limit_s` (300 s)",
            "landing",
        ),
        _S.LANDING: PhaseLimit(
            f"on the ground, armed: asked to disarm after {DISARM_ASKED_AFTER_S:g} s, ended after"
            f" {GROUND_ARMED_LIMIT_S:g} s; unheard: `lost_after_s` (120 s); {LANDING_LIMIT_S:g} s in all",
            "lost: on the ground, armed, does not disarm; lost: nothing heard; lost: no landing was seen",
        ),
    }
)
