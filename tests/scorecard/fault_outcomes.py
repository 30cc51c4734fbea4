"""How a flight must end under every fault, by name: the table behind ``docs/faults.md`` and the tests that fly it.

``python -m tests.scorecard.fault_outcomes`` from the root prints the page. An outcome is not what happened to happen:
each row says why it is the one a careful operator would want. The flight is `relay_plan(2)`: two stations,
one handover.
"""

from __future__ import annotations

import math
import random
import sys
from dataclasses import dataclass, field
from typing import Any

from sitl_fixtures.faults import FAULTS
from sitl_fixtures.process import Impairment, LossyChannel
from tests.support.flights.virtual import Proxy, VirtualFlight
from tests.support.paths import ROOT

PAGE = ROOT / "docs" / "faults.md"

COMPLETED, CONTINGENCY, REFUSED, LOST, LAPSED = "completed", "contingency", "refused", "lost", "lapsed"
STRANGE = "the vehicle holds a target that is not ours"
BEHIND = "the vehicle falls behind"
LAPSE = "lapse"
BLIND = "the vehicle's position is not heard"


@dataclass(frozen=True)
class Outcome:
    """How it must end (one of several where chance of the moment decides), and an alarm that must have been raised."""

    ends: tuple[str, ...]
    alarm: str = ""

    def __str__(self) -> str:
        return " or ".join(self.ends) + (f"; alarm: {self.alarm}" if self.alarm else "")


@dataclass(frozen=True)
class Row:
    """One fault: ``specification`` as for the simulator's ``--fault`` (or the name of a row of `NETWORK`)."""

    specification: str
    px4: Outcome
    ardupilot: Outcome
    why: str

    def outcome(self, autopilot: str) -> Outcome:
        """What must come of it."""
        return self.px4 if autopilot == "px4" else self.ardupilot

    @property
    def name(self) -> str:
        """Without argument and time."""
        return self.specification.split("@")[0].split(":")[0]


def both(specification: str, end: str | tuple[str, ...], why: str, alarm: str = "") -> Row:
    """The same of both autopilots."""
    outcome = Outcome((end,) if isinstance(end, str) else end, alarm)
    return Row(specification, outcome, outcome, why)


def each(specification: str, px4: Outcome, ardupilot: Outcome, why: str) -> Row:
    """Of each its own."""
    return Row(specification, px4, ardupilot, why)


def done(alarm: str = "") -> Outcome:
    """Flown as planned."""
    return Outcome((COMPLETED,), alarm)


def way_out(alarm: str = "") -> Outcome:
    """Down safely, other than planned."""
    return Outcome((CONTINGENCY,), alarm)


_LOSS_T = "PX4 gives the stream up after 1 s, ArduPilot's GUID_TIMEOUT is 3 s"
_SILENT = "the autopilot may have acted on our silence: no stream again without a person, its own return in the end"
_UNREAD = "where its own return would lead is not known: no rally points read back, no flight"
_NOTHING = "nothing the flight hangs on"
_ASKED = "what is not answered is asked for again"

ROWS: tuple[Row, ...] = (
    # link
    both("telemetry-loss", CONTINGENCY, "5 s without a proof that anything arrives: " + _SILENT, LAPSE),
    both("telemetry-loss-share", COMPLETED, "a lossy link is no dead link"),
    both("telemetry-late", COMPLETED, "half a second late is within every limit"),
    both("telemetry-repeated", COMPLETED, "the same message twice says nothing new"),
    both("telemetry-reordered", COMPLETED, "older stamps are left aside and are no reboot"),
    each("link-cut", way_out(LAPSE), done(), f"before the next station covers: {_LOSS_T}; later the next takes over"),
    each("link-deaf", way_out(LAPSE), done(), f"telemetry proves nothing of the way up: {_LOSS_T}"),
    each("link-mute", way_out(LAPSE), done(), f"heard or not cannot be known without an answer: {_LOSS_T}"),
    both(
        "link-cut:0@T22+1000",
        COMPLETED,
        "the first station's link dies inside the overlap: the next has it or takes it",
    ),
    both("link-cut:1@0+1000", REFUSED, "a link of the plan that is dead before take-off"),
    both("uplink-loss", CONTINGENCY, "telemetry alone proves nothing: " + _SILENT, LAPSE),
    both("uplink-loss-share", COMPLETED, "a stream of 20 Hz has setpoints to spare"),
    both("uplink-late", COMPLETED, "0.3 s late is along the path, within the lag that is allowed"),
    both("frames-damaged", COMPLETED, "a frame with a wrong checksum is a frame lost"),
    both("frames-short", COMPLETED, "half a frame is a frame lost, and does not eat the next"),
    both("frames-littered", COMPLETED, "rubbish between frames is skipped"),
    both("sequence-jumps", COMPLETED, "sequence numbers are for statistics"),
    both("unknown-messages", COMPLETED, "what nobody knows is dropped unread"),
    # telemetry
    both("heartbeat-loss", COMPLETED, "for 10 s other messages show that it flies our setpoints"),
    both(
        "heartbeat-stuck",
        LOST,
        "it shows no landing: it must not be called landed; given up two minutes after touchdown",
    ),
    both("heartbeat-late", COMPLETED, "a mode seen 3 s late is waited for"),
    both("heartbeat-critical", COMPLETED, "the autopilot's own judgement moves its own failsafe, not us"),
    both("heartbeat-wrong-autopilot", REFUSED, "setpoints in the wrong frame would be flown elsewhere"),
    both("other-vehicle", COMPLETED, "another system id is another vehicle"),
    both("position-loss", COMPLETED, "10 s: after five it is held, and goes on when its place is known again", BLIND),
    both(
        "position-stuck", (CONTINGENCY, LOST), "it seems to stand while we go on: held, then the autopilot's own return"
    ),
    both("position-nan", COMPLETED, "the global position is what we go by; NaN goes into no record"),
    both("position-late", COMPLETED, "judged on the vehicle's clock, a second late is not a second behind"),
    both("echo-loss", COMPLETED, "probes prove the link without echoes"),
    both(
        "echo-stuck", COMPLETED, "somebody else's target would look like that: told; it follows, so flown on", STRANGE
    ),
    both("clock-jump", COMPLETED, "forward: no reboot; tracking is judged by the new clock"),
    both("clock-stuck", CONTINGENCY, "without a clock no place can be judged: held, then back along the path", BLIND),
    both("text-flood", COMPLETED, "texts wait until the tick's setpoint is out"),
    both("text-rubbish", COMPLETED, "a text that is none is no reason to stop"),
    both("home-unknown", COMPLETED, "nothing we send refers to home"),
    both("origin-unknown", REFUSED, "without the EKF origin no setpoint can be right"),
    both("version-unknown", COMPLETED, "the profile's own encoding of parameters is used, and read back"),
    # commands
    each(
        "ack-lost", done(), Outcome((REFUSED,)), "PX4: heartbeats and echoes tell; ArduPilot: as one locked to others"
    ),
    both("ack-lost-first", COMPLETED, _ASKED),
    both("ack-late", COMPLETED, "an answer to the first asking answers the second too"),
    both("ack-repeated", COMPLETED, "the second answer answers nothing"),
    each("ack-foreign", done(), Outcome((REFUSED,)), "an answer to another station is not ours; see ack-lost"),
    each(
        "ack-wrong-command", done(), Outcome((REFUSED,)), "an answer to another command is not this one's; see ack-lost"
    ),
    both("ack-without-effect", REFUSED, "an acknowledgement is not a fact: what was asked for never comes"),
    both("command-denied", REFUSED, "what the flight is watched by cannot be asked for"),
    both("command-failed", REFUSED, "as denied"),
    both("command-unsupported", REFUSED, "as denied"),
    both("command-rejected-once", COMPLETED, _ASKED),
    both("command-in-progress", COMPLETED, "in progress lengthens the wait"),
    both("command-lost", REFUSED, "nothing it is told reaches it, before it is armed"),
    both("command-lost-first", COMPLETED, _ASKED),
    both("command-late", COMPLETED, "a second late is waited for"),
    both("mode-without-effect", REFUSED, "accepted and not done: the heartbeat alone is believed"),
    both("arm-refused", REFUSED, "its own checks fail: its words are kept"),
    each("takeoff-ignored", done(), way_out(), "PX4 climbs by setpoints; ArduPilot disarms again on the ground"),
    # parameters
    both("param-set-ignored", REFUSED, "unsafe failsafes that cannot be set"),
    both("param-set-refused", REFUSED, "set is what reads back as set"),
    both("param-reply-lost", COMPLETED, _ASKED),
    both("param-reply-late", COMPLETED, "waited for"),
    both("param-silent", REFUSED, "failsafes that cannot be read are not there"),
    both("param-list-gaps", COMPLETED, "parameters are read by name"),
    both("param-wrong-value", REFUSED, "what reads back unsafe is unsafe"),
    both("param-revert", COMPLETED, "not watched in flight; the stream never needs them while it runs"),
    # missions: none is needed in flight by these requests
    both("mission-ack-lost", COMPLETED, _ASKED),
    both("mission-request-lost", COMPLETED, _ASKED),
    both("mission-request-repeated", COMPLETED, "the same item again"),
    both("mission-item-lost", COMPLETED, _ASKED),
    both("mission-refused", COMPLETED, "no rally point is asked for by this mission"),
    both("mission-count-off", REFUSED, _UNREAD),
    both("mission-silent", REFUSED, _UNREAD),
    # flight
    each("setpoints-lost", way_out(LAPSE), done(), f"5 s without setpoints: {_LOSS_T}, runs on and catches up"),
    both("setpoints-lost-share", COMPLETED, "a stream of 20 Hz has setpoints to spare"),
    both("setpoints-late", COMPLETED, "0.3 s late is along the path, within the lag that is allowed"),
    each(
        "setpoints-stuck",
        way_out(LAPSE),
        done(STRANGE),
        "it stands at an old target: PX4 is given up, ArduPilot goes on",
    ),
    both("mode-to-hold", CONTINGENCY, "it left the mode and we do not fight: " + _SILENT, LAPSE),
    both("mode-to-return", CONTINGENCY, "its failsafe has it: silence, until it is down", LAPSE),
    both("mode-to-land", CONTINGENCY, "its failsafe has it: silence, until it is down", LAPSE),
    each(
        "pilot-takes-over",
        Outcome((LAPSED,), LAPSE),
        Outcome((CONTINGENCY, LAPSED), LAPSE),
        "a pilot is never fought: silence as long as the pilot has it",
    ),
    both("disarm-in-flight", LOST, "it falls; nothing we send helps"),
    each(
        "foreign-station-streams",
        done(STRANGE),
        done(),
        "PX4 obeys anybody: told at once; ArduPilot was told whom to hear",
    ),
    each(
        "foreign-station-returns",
        way_out(LAPSE),
        done(),
        "PX4 obeys anybody, and left the mode; ArduPilot does not hear it",
    ),
    both(
        "foreign-station-parameter", COMPLETED, "PX4 has no such parameter; ArduPilot does not hear the foreign station"
    ),
    both("foreign-station-heartbeat", COMPLETED, "a heartbeat commands nothing"),
    # vehicle
    both("reboot", LOST, "it comes up disarmed and falls; noticed and silent within two seconds"),
    both("hang", CONTINGENCY, "3 s without an answer: " + _SILENT, LAPSE),
    both("clock-rate", COMPLETED, "a vehicle a tenth slow is waited for"),
    both("ekf-failure", CONTINGENCY, "it lands blind by itself; we do not call it back", LAPSE),
    both("gps-loss", CONTINGENCY, "its estimate fails after 10 s: as ekf-failure", LAPSE),
    both("gps-jump", COMPLETED, "it believes its estimate, and so do we: nobody else measures where it is"),
    both("altitude-bias", COMPLETED, "as gps-jump"),
    both("origin-shift", COMPLETED, "setpoints are laid from the new origin, and it is told", "EKF origin moved"),
    both("home-shift", COMPLETED, "nothing we send refers to home"),
    both("never-ready", REFUSED, "no position, no flight"),
    each("battery-low", done("battery low"), way_out(LAPSE), "PX4 warns; ArduPilot returns, as preflight has it set"),
    both("battery-critical", CONTINGENCY, "its battery failsafe, set by preflight: silence, until it is down", LAPSE),
    each("battery-drain", done(), way_out(LAPSE), "PX4 counts the charge, which lasts; ArduPilot the volts, which sag"),
    both("wind-gust", COMPLETED, "within what it can lean against"),
    both("wind", COMPLETED, "within what it can lean against"),
    both("slow-vehicle", COMPLETED, "the reference waits for it, and the schedule moves", BEHIND),
    both("drag", COMPLETED, "within what it can lean against"),
    both("thrust-loss", COMPLETED, "what is left is enough for this plan"),
    both("cannot-climb", (CONTINGENCY, LOST), "stuck on the ground or too low: ended there", "take-off stuck"),
    both("crash", (CONTINGENCY, LOST), "it does not follow and is down: who disarms first decides the word"),
)


@dataclass
class Channels(Proxy):
    """The simulator's own lossy channel on every link, one for each station, in virtual time."""

    impairment: Impairment = field(default_factory=Impairment)

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._channels: dict[str, LossyChannel] = {}

    def deliveries(self, station: str, now_s: float) -> list[float]:
        """When a datagram sent now arrives: no time, one, or several."""
        seed = self.seed + 1000 * len(self._channels)
        channel = self._channels.setdefault(station, LossyChannel(self.impairment, seed))
        channel.send(b"", now_s)
        times = []
        while (at_s := channel.next_event_s()) < math.inf:
            times += [at_s] * len(channel.receive(at_s))
        return times


NETWORK: dict[str, tuple[str, Impairment]] = {
    "net-loss-10": ("10 % of datagrams lost, each by itself", Impairment(loss=0.1)),
    "net-loss-30": ("30 % lost, each by itself", Impairment(loss=0.3)),
    "net-loss-bursts": ("10 % lost, in runs of 4", Impairment(loss=0.1, burst=4.0)),
    "net-latency-100ms": ("everything 100 ms late", Impairment(latency_s=0.1)),
    "net-latency-200ms": ("everything 200 ms late", Impairment(latency_s=0.2)),
    "net-jitter-100ms": ("up to 100 ms late, overtaking", Impairment(jitter_s=0.1)),
    "net-duplicates": ("30 % twice", Impairment(duplication=0.3)),
    "net-reordering": ("30 % held back 50 ms", Impairment(reordering=0.3)),
    "net-bad": (
        "10 % lost, 100 ms late, 50 ms of jitter, 5 % twice, 5 % held back",
        Impairment(loss=0.1, latency_s=0.1, jitter_s=0.05, duplication=0.05, reordering=0.05),
    ),
    "net-gaps": (
        "every link dead for 0.4 s, every 5 s",
        Impairment(cuts=tuple((5.0 * k, 5.0 * k + 0.4) for k in range(4, 80))),
    ),
    "net-dead-in-flight": ("every link dead from 25 s on", Impairment(cuts=((25.0, 1e9),))),
    "net-dead-at-start": ("every link dead from the start", Impairment(cuts=((0.0, 1e9),))),
}
"""Bad networks, on every link and both ways: the proxy's own impairments."""

NETWORK_ROWS: tuple[Row, ...] = (
    both("net-loss-10", COMPLETED, "a lossy link is no dead link"),
    both(
        "net-loss-30",
        (COMPLETED, REFUSED),
        "in flight setpoints to spare; a failsafe that could not be read is refused",
    ),
    both("net-loss-bursts", COMPLETED, "runs of 4 at 20 Hz are 0.2 s"),
    both("net-latency-100ms", COMPLETED, "late is along the path"),
    both("net-latency-200ms", COMPLETED, "late is along the path"),
    both("net-jitter-100ms", COMPLETED, "stamps put order into it"),
    both("net-duplicates", COMPLETED, "the same twice says nothing new"),
    both("net-reordering", COMPLETED, "stamps put order into it"),
    both("net-bad", COMPLETED, "what a flight over hills must bear"),
    both("net-gaps", COMPLETED, "shorter than anybody's patience"),
    both("net-dead-in-flight", LOST, "nothing is heard any more: its own failsafe has it, and we say so", LAPSE),
    both("net-dead-at-start", REFUSED, "no vehicle is heard"),
)

SETTINGS: dict[str, Any] = {
    "hold_limit_s": 15.0,
    "wait_for_station_s": 8.0,
    "lost_after_s": 20.0,
    "arm_timeout_s": 10.0,
    "connect_timeout_s": 8.0,
}
LONG_ENOUGH_S = 400.0
VERY_LONG_S = 2200.0
"""For a landing that is never seen: half an hour."""


def fly(row: Row, autopilot: str, seed: int = 1) -> VirtualFlight:
    """Fly the plan under a fault, to the end or as long as it can take."""
    from tests.support.plans.planned import relay_plan

    network = NETWORK.get(row.specification)
    proxy = Channels(seed=seed, impairment=network[1]) if network is not None else None
    config: dict[str, object] = {} if network is not None else {"faults": (row.specification,)}
    plan = relay_plan(2)
    flight = VirtualFlight(plan, autopilot, proxy=proxy, frugal=True, config=config, request=SETTINGS)
    flight.run(limit_s=VERY_LONG_S if row.outcome(autopilot).ends == (LOST,) else LONG_ENOUGH_S)
    return flight


def judge(row: Row, autopilot: str, flight: VirtualFlight) -> list[str]:
    """What is wrong with how it went; empty when it went as it must."""
    wanted, problems = row.outcome(autopilot), []
    if flight.core.state.value not in wanted.ends:
        problems.append(f"ended {flight.core.state.value}, not {' or '.join(wanted.ends)}")
    if wanted.alarm and not flight.said("alarm", what=wanted.alarm):
        problems.append(f"no alarm {wanted.alarm!r}")
    ids = {flight.core.context.control.system_ids[s]: s for s in flight.stations}
    for one in flight.accepted:
        own = ids.get(one.system_id)
        if own is None:
            continue  # the foreign station's
        if own != flight.stations[one.link]:
            problems.append(f"{own} was obeyed over another link at {one.time_s:.2f} s")
        # One that the vehicle itself held back is obeyed at a moment nobody sent it.
        if not math.isnan(one.sent_s) and not own == one.station == one.holder_when_sent:
            problems.append(f"{own} was obeyed at {one.time_s:.2f} s while {one.holder_when_sent} was in control")
    lapses = [e.time_s for e in flight.said("state", to=LAPSED)]
    setpoints = flight.sent_messages("SET_POSITION_TARGET_GLOBAL_INT", "SET_POSITION_TARGET_LOCAL_NED")
    if lapses and any(time_s > lapses[0] for time_s, _, _, _ in setpoints):
        problems.append("streamed again after a lapse, unasked")
    down = flight.core.state.value in (COMPLETED, CONTINGENCY, REFUSED)
    if down and (flight.vehicle.autopilot.armed or not flight.vehicle.body.on_ground):
        problems.append("called down while armed or in the air")
    return problems


def all_rows() -> tuple[Row, ...]:
    """Every row, of the vehicle and of the network."""
    return ROWS + NETWORK_ROWS


def page() -> str:
    """``docs/faults.md``."""
    lines = [
        "# Faults, and how a flight must end under each",
        "",
        f"{len(all_rows())} faults of the protocol, the network and the vehicle, injected by name (`skyrelay simulate"
        " --list-faults`; the network's through the lossy proxy), each flown on both autopilot models in"
        " virtual time over two stations with one handover. `make soak` flies all; `make test` a sample. This page is"
        " printed from the table the tests assert (`python -m tests.scorecard.fault_outcomes`).",
        "",
        "Under every fault, whatever the row says: each setpoint obeyed was sent by the one station in control then,"
        " over its own link and under its own id; after a lapse no setpoint is sent without a person's word; a flight"
        " called completed, contingency or refused has its vehicle on the ground and disarmed.",
        "",
        "`completed`: flown as planned. `refused`: never armed. `contingency`: down other than planned. `lost`: its"
        " own failsafe has it, or it is no longer heard. `lapsed`: we are silent, somebody else has it.",
        "",
        "Times: seconds since boot, `T` since the first setpoint obeyed (in the climb on PX4, after it on ArduPilot).",
    ]
    group = ""
    head = "| fault | what goes wrong | PX4 must end | ArduPilot must end | why |"
    for row in all_rows():
        fault = FAULTS.get(row.name)
        now = "network" if fault is None else fault.group
        if now != group:
            group = now
            lines += ["", f"## {group.capitalize()}", "", head, "|---|---|---|---|---|"]
        effect = NETWORK[row.name][0] if fault is None else fault.effect + _when(row)
        lines.append(f"| `{row.specification}` | {effect} | {row.px4} | {row.ardupilot} | {row.why} |")
    return "\n".join(lines) + "\n"


def _when(row: Row) -> str:
    fault = FAULTS[row.name]
    start, duration_s = fault.start, fault.duration_s
    if "@" in row.specification:
        start, _, duration = row.specification.split("@")[1].partition("+")
        duration_s = float(duration) if duration else duration_s
    default = (
        fault.default if isinstance(fault.default, float) and fault.argument and ":" not in row.specification else None
    )
    words = f" ({fault.argument.lower()} {default:g})" if default is not None else ""
    words += "" if start == "0" else f", from {start}"
    return words + (f" for {duration_s:g} s" if math.isfinite(duration_s) and duration_s < 500.0 else "")


if __name__ == "__main__":
    sys.stdout.write(page())
