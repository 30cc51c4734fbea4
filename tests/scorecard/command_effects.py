"""Every operator command in every state, flown: the table behind ``docs/commands.md`` and the tests that fly it.

``python -m tests.scorecard.command_effects`` from the root prints the page.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from gcs.flight import FlightState, OperatorCommand, TransitionError
from gcs.operator_commands import EFFECT_TEXTS, EFFECTS, PHASES, Effect, effect_of
from link.dialect import mavlink
from tests.support.flights.moments import SETPOINTS
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.paths import ROOT
from tests.support.plans.planned import relay_plan

PAGE = ROOT / "docs" / "commands.md"
S, C, E = FlightState, OperatorCommand, Effect

ENDED = tuple(state for state in FlightState if state.ended)
OPEN = tuple(state for state in FlightState if not state.ended)
UNCHANGED = (S.CONNECTING, S.IDENTIFYING, S.PREFLIGHT)
"""Nothing may have been changed on the vehicle yet: a flight that ends here may have nothing to say to it."""
GIVEN_BACK = ("MAV_GCS_SYSID", "MAV_GCS_SYSID_HI", "MAV_OPTIONS")
SETTINGS: dict[str, Any] = {"hold_limit_s": 60.0, "lost_after_s": 20.0, "arm_timeout_s": 20.0, "arrival_hold_s": 8.0}
ARGUMENTS: dict[OperatorCommand, dict[str, Any]] = {
    C.READY: {"handover": 1},
    C.ACCEPT: {"handover": 1},
    C.REFUSE: {"handover": 1, "reason": "birds"},
    C.AUTHORISE: {"until_s": 1000.0},
}


@dataclass(frozen=True)
class Moment:
    """A state of a flight, and how to get there."""

    state: FlightState
    name: str
    reach: Callable[[VirtualFlight], None]
    request: dict[str, Any]
    cut: bool = False


def _to(state: FlightState, extra_s: float = 0.0) -> Callable[[VirtualFlight], None]:
    def reach(one: VirtualFlight) -> None:
        one.run(until=lambda: one.core.state is state, limit_s=400.0)
        one.run_for(extra_s)

    return reach


def _climb(one: VirtualFlight) -> None:
    """A few metres up, on the way to ten and more."""
    ground_m = one.vehicle.body.height_m
    one.run(until=lambda: one.vehicle.body.height_m > ground_m + 4.0, limit_s=400.0)


def _after(state: FlightState, *commands: str) -> Callable[[VirtualFlight], None]:
    def reach(one: VirtualFlight) -> None:
        one.run(until=lambda: one.plan_s >= 12.0, limit_s=400.0)
        for command in commands:
            one.core.command(command, by="before")
            one.run_for(4.0)
        one.run(until=lambda: one.core.state is state, limit_s=100.0)

    return reach


def _lapse(one: VirtualFlight) -> None:
    """The process hangs in cruise for longer than any autopilot waits."""
    one.run(until=lambda: one.plan_s >= 8.0, limit_s=400.0)
    one.frozen = True
    one.run_for(4.0)
    one.frozen = False
    one.run(until=lambda: one.core.state is S.LAPSED, limit_s=5.0)
    one.run_for(2.0)


def _ended(state: FlightState) -> Callable[[VirtualFlight], None]:
    def reach(one: VirtualFlight) -> None:
        if state is S.REFUSED:
            one.run(until=lambda: one.core.state is S.PREFLIGHT, limit_s=100.0)
            one.core.command("abort")
        elif state in (S.LANDED, S.CONTINGENCY):
            _climb(one)
            one.core.command("land" if state is S.LANDED else "abort")
        elif state is S.LOST:
            one.run(until=lambda: one.plan_s >= 3.0, limit_s=100.0)
            one.proxy.cuts += [(station, one.now_s, 1e9) for station in one.links]
        one.run(until=lambda: one.core.state.ended, limit_s=600.0)

    return reach


_WAIT: dict[str, Any] = {"auto_launch": False}
MOMENTS: tuple[Moment, ...] = (
    Moment(S.CONNECTING, "connecting", lambda one: one.step(), {}),
    Moment(S.IDENTIFYING, "identifying", _to(S.IDENTIFYING), {}),
    Moment(S.PREFLIGHT, "preflight", _to(S.PREFLIGHT, 0.2), {}),
    Moment(S.READY, "ready", _to(S.READY, 1.0), _WAIT),
    Moment(S.ARMING, "arming", _to(S.ARMING, 0.2), {}),
    Moment(S.TAKEOFF, "takeoff, just armed", _to(S.TAKEOFF), {}),
    Moment(S.TAKEOFF, "takeoff, in the climb", _climb, {}),
    Moment(S.TRANSIT, "transit", _to(S.TRANSIT, 0.1), {}),
    Moment(S.CRUISE, "cruise", _after(S.CRUISE), {}),
    Moment(S.HOLDING, "holding", _after(S.HOLDING, "hold"), {}),
    Moment(S.HOLDING, "holding on the way back", _after(S.HOLDING, "abort", "hold"), {}),
    Moment(S.RETURNING, "returning", _after(S.RETURNING, "abort"), {}),
    Moment(S.LAPSED, "lapsed", _lapse, {}),
    Moment(S.ARRIVED, "arrived", _to(S.ARRIVED, 0.2), {}),
    Moment(S.LANDING, "landing, not yet shown", _after(S.LANDING, "land"), {}),
    Moment(S.LANDING, "landing", _to(S.LANDING, 3.0), {}),
    *(Moment(state, state.value, _ended(state), {}) for state in ENDED),
)


def reach(moment: Moment, autopilot: str) -> VirtualFlight:
    """A flight at that moment."""
    plan = relay_plan(2)
    one = VirtualFlight(plan, autopilot, proxy=Proxy(), frugal=True, request={**SETTINGS, **moment.request})
    moment.reach(one)
    assert one.core.state is moment.state, f"{moment.name}: {one.core.state}"
    return one


def try_cell(one: VirtualFlight, moment: Moment, command: OperatorCommand) -> list[str]:
    """Command it, fly on; what is not as the table says."""
    effect, count, began_s = effect_of(command, moment.state), len(one.events), one.now_s
    given = dict(ARGUMENTS.get(command, {}))
    if command is C.REPLAN and effect is E.REPLAN:
        given["upcoming"] = one.core.make_ready(one.plan.to_document())
    elif command is C.REPLAN:
        given["upcoming"] = None
    try:
        one.core.command(command, by="pilot", **given)
        refused = ""
    except TransitionError as error:
        refused = str(error)
    if effect is E.REFUSED:
        told = refused.startswith(f"'{command}' needs a flight that is ") and f"this one is {moment.state}" in refused
        problems = [] if told else [f"not refused in words: {refused!r}"]
        return problems + ([] if one.core.state is moment.state else ["a refusal changed the state"])
    if refused:
        return _reasoned(one, moment, command, refused)
    sent = len(one.sent)
    problems = [f"{effect.value}: {problem}" for problem in CHECKS[effect](one, moment, began_s)]
    if not any(e.kind == "word" and e.data["word"] == command for e in one.events[count:]):
        problems.append("the command is not in the history")
    quiet = effect is E.NOTE or (effect is E.STOP_ON_GROUND and moment.state in UNCHANGED)
    if sent == len(one.sent) and not quiet:
        problems.append("silence")
    return problems


def _reasoned(one: VirtualFlight, moment: Moment, command: OperatorCommand, refused: str) -> list[str]:
    """Refusals that hang on more than the state: a handover done, a plan that begins elsewhere."""
    done = command is C.REFUSE and refused.endswith("is done")
    moved = command is C.REPLAN and one.core.airborne.held.resumes is S.RETURNING
    return [] if done or moved else [f"refused: {refused}"]


def _commands_since(one: VirtualFlight, since_s: float) -> list[tuple[float, Any]]:
    sent = one.sent_messages("COMMAND_LONG", *SETPOINTS)
    return [(time_s, message) for time_s, _, _, message in sent if time_s >= since_s]


def _lands(*ends: FlightState, at_once: bool = True) -> Callable[[VirtualFlight, Moment, float], list[str]]:
    """LAND is asked for before anything else, the vehicle comes down where it is, and the end is one of those."""

    def check(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
        profile, problems = one.core.context.vehicle.profile, []
        body = one.vehicle.body
        lat_deg, lon_deg, height_m, speed_m_s = body.lat_deg, body.lon_deg, body.height_m, body.speed_m_s
        highest = height_m
        end_s = one.now_s + 300.0
        while not one.core.finished and one.now_s < end_s:
            one.step()
            highest = max(highest, body.height_m)
        lands = [
            time_s
            for time_s, message in _commands_since(one, began_s)
            if message.get_type() == "COMMAND_LONG"
            and message.command == mavlink.MAV_CMD_DO_SET_MODE
            and (message.param2, message.param3) == profile.set_mode_parameters(profile.land_mode)[1:3]
        ]
        if at_once and (not lands or lands[0] - began_s > 2.0 / 20.0):
            problems.append(f"LAND was not asked for at once: {lands[:1]}, {began_s}")
        if one.core.state not in ends:
            problems.append(f"ended {one.core.state}, not {' or '.join(ends)}: {one.states[-3:]}")
        if highest > height_m + 2.0 + 1.5 * speed_m_s:
            problems.append(f"it climbed {highest - height_m:.1f} m on")
        east, north = one.plan.plane.to_plane([lat_deg, body.lat_deg], [lon_deg, body.lon_deg])
        away_m = float(((east[1] - east[0]) ** 2 + (north[1] - north[0]) ** 2) ** 0.5)
        if away_m > 5.0 + 8.0 * speed_m_s:
            problems.append(f"it came down {away_m:.0f} m away")
        if one.vehicle.autopilot.armed or not body.on_ground:
            problems.append("not down and disarmed")
        if moment.state in (S.TAKEOFF, S.LAPSED) and (profile.climbs_by_command or moment.state is S.LAPSED):
            streamed = [m for _, m in _commands_since(one, began_s) if m.get_type() in SETPOINTS]
            problems += [f"{len(streamed)} setpoints were sent"] if streamed else []
        return problems

    return check


def _stops(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    one.run(limit_s=90.0)
    before = (
        VirtualFlight(one.plan, one.request.autopilot).vehicle.parameters
        if one.request.autopilot == "ardupilot"
        else {}
    )
    kept = [name for name in GIVEN_BACK if before and one.vehicle.parameters[name] != before[name]]
    problems = [f"not given back: {', '.join(kept)}"] if kept else []
    problems += [] if one.core.state in (S.REFUSED, S.CONTINGENCY) else [f"ended {one.core.state}"]
    if one.core.state is S.REFUSED and any(e.data.get("to") == "takeoff" for e in one.said("state")):
        problems.append("called refused after a take-off")
    if one.vehicle.autopilot.armed or not one.vehicle.body.on_ground:
        problems.append("not on the ground with motors off")
    one.run_for(10.0)
    return problems + (["it armed afterwards"] if one.vehicle.autopilot.armed else [])


def _becomes(*states: FlightState, within_s: float = 0.2) -> Callable[[VirtualFlight, Moment, float], list[str]]:
    def check(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
        one.run_for(0.1)
        one.run(until=lambda: one.core.state in states, limit_s=within_s)
        return [] if one.core.state in states else [f"is {one.core.state}, not {' or '.join(states)}"]

    return check


def _stands(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    one.run_for(15.0)
    stands = one.core.state is S.HOLDING and one.vehicle.body.speed_m_s < 0.5
    return [] if stands else [f"{one.core.state} at {one.vehicle.body.speed_m_s:.1f} m/s"]


def _re_enters(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    one.run(limit_s=400.0)
    problems = [] if one.core.state is S.COMPLETED else [f"ended {one.core.state}"]
    return problems + ([] if "transit" in one.states[one.states.index("lapsed") :] else ["no transit back"])


def _contingency(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    problems = _becomes(S.RETURNING)(one, moment, began_s)
    one.run(limit_s=400.0)
    return problems + ([] if one.core.state is S.CONTINGENCY else [f"ended {one.core.state}"])


def _last_resort(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    one.run_for(4.0)
    mode = one.core.context.vehicle.mode
    problems = [] if mode == "RTL" else [f"shows {mode}"]
    one.run(limit_s=600.0)
    return problems + ([] if one.core.state is S.CONTINGENCY else [f"ended {one.core.state}"])


def _noted(one: VirtualFlight, moment: Moment, began_s: float) -> list[str]:
    one.run_for(0.3)
    return []


CHECKS: dict[Effect, Callable[[VirtualFlight, Moment, float], list[str]]] = {
    E.LAUNCH: _becomes(S.ARMING, within_s=20.0),
    E.PREFLIGHT: _becomes(S.PREFLIGHT, within_s=20.0),
    E.STOP_ON_GROUND: _stops,
    E.LAND_HERE: _lands(S.LANDED, S.CONTINGENCY),
    E.LAND_AT_END: _lands(S.COMPLETED),
    E.STOP_CLIMB: _lands(S.CONTINGENCY),
    E.ABANDON: _lands(S.CONTINGENCY),
    E.GO_ON_LANDING: _lands(S.COMPLETED, S.LANDED, S.CONTINGENCY, at_once=False),
    E.HOLD: _stands,
    E.KEEP_HOLDING: _stands,
    E.GO_ON: _becomes(S.CRUISE, S.RETURNING),
    E.RE_ENTER: _re_enters,
    E.CONTINGENCY: _contingency,
    E.GO_ON_RETURNING: _contingency,
    E.LAST_RESORT: _last_resort,
    E.NOTE: _noted,
    E.REPLAN: _becomes(S.CRUISE),
}


def page() -> str:
    """``docs/commands.md``."""
    heads = [command.value for command in OperatorCommand]
    lines = [
        "# Commands, and when every phase ends",
        "",
        "What each operator command does in each state of a flight, on both autopilots. The code accepts commands by"
        " this table (`gcs.operator_commands`), and each cell is flown in virtual time on both autopilot models; the"
        " page is printed from it (`python -m tests.scorecard.command_effects`). An empty cell is refused: the words"
        " say what the command needs, which state the flight is in and what it takes instead, and nothing changes.",
        "",
        "Ctrl-C of `skyrelay fly` (and SIGTERM, of it and of the streamer) is `abort`, from the moment the vehicle"
        " is asked anything; a second Ctrl-C lets go of the vehicle, whose own failsafe then has it. `skyrelay"
        " flight ID COMMAND` and REST give the same commands.",
        "",
        f"| state | {' | '.join(heads)} |",
        "|---|" + "---|" * len(heads),
    ]
    for state in OPEN:
        cells = [effect_of(command, state) for command in OperatorCommand]
        words = " | ".join("" if effect is E.REFUSED else effect.value for effect in cells)
        lines.append(f"| {state.value} | {words} |")
    lines += [
        "",
        f"Ended ({', '.join(state.value for state in ENDED)}): every command is refused.",
        "",
        "| effect | what it does |",
        "|---|---|",
        *(f"| {effect.value} | {EFFECT_TEXTS[effect]} |" for effect in Effect),
        "",
        "A command given while the flight is being stopped on the ground is refused as too late. `refuse` names a"
        " handover to come; `replan` needs a plan made for this flight's place.",
        "",
        "## How it ends",
        "",
        "| end | exit code of `fly` | |",
        "|---|---|---|",
        "| completed | 0 | flown as planned, landed at the destination |",
        "| landed | 0 | landed where it was because an operator commanded `land`; told so, not as planned |",
        "| refused | 4 | never armed |",
        "| contingency | 4 | down, other than planned: an abort, a hold that ran out, a lost C2 link |",
        "| lost | 4 | its own failsafe has it, or it is no longer heard, or it does not disarm |",
        "",
        "`land` while a contingency is being flown, or after the C2 link was lost, ends as a contingency.",
        "",
        "## Phases and their limits",
        "",
        "| state | limit | then |",
        "|---|---|---|",
        *(f"| {state.value} | {PHASES[state].limit} | {PHASES[state].end} |" for state in OPEN),
        "",
        "A landing that was seen and is left for another mode, in the air for 3 s, is not asked for again: somebody"
        " else has the vehicle, and the flight is silent (lapsed). Motors are asked off without force: the autopilot"
        " itself refuses while it thinks that it flies.",
    ]
    return "\n".join(lines) + "\n"


assert set(EFFECTS) == set(OperatorCommand)

if __name__ == "__main__":
    sys.stdout.write(page())
