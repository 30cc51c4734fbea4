"""A flight as lines of text: what is worth a line of its own, and the line that says where it is now."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from api.cli.console import Progress
from gcs.flight import FlightState
from link.transport import Sender

if TYPE_CHECKING:
    from gcs.flight import FlightEvent
    from gcs.plan import Plan
    from link.streamer import FlightResult

_NOT_PLANNED = ("abort", "land")
LATE_S = 2.0
"""An arrival later than that is not as planned."""
FAR_OFF_PLAN_M = 10.0
"""A vehicle that was so far from where the plan had it did not fly as planned."""
_WORTH_TELLING = {"released", "late", "failed", "timed_out", "refused"}
# Elsewhere the distance from the plan means nothing.
_ON_THE_PATH = {"transit", "cruise", "holding", "returning"}
_DONE = {
    "released": "done",
    "late": "LATE: the receiving station is not ready",
    "failed": "FAILED: the vehicle said no",
    "timed_out": "TIMED OUT: no evidence from the vehicle",
    "refused": "REFUSED by the crew of a station",
}


# States by the name the field has for them, where ours is shorter.
_STATE_TEXTS = {"lapsed": "lost C2 link", "contingency": "contingency procedure", "landed": "landed by command"}


def state_text(state: object) -> str:
    """A flight's state, as people read it."""
    return _STATE_TEXTS.get(str(state), str(state))


def clock(seconds: float) -> str:
    """Seconds as h:mm:ss."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02d}:{whole % 60:02d}"


def lapse_text(lapse: Mapping[str, Any]) -> str:
    """After the C2 link was lost: what is happening, until when, what may be commanded."""
    parts = [f"the vehicle is in {lapse.get('mode') or 'no mode known'}"]
    if lapse.get("on_ground"):
        parts.append("on the ground, armed" if lapse.get("armed") else "on the ground")
    near, margin_m = lapse.get("nearest_station"), lapse.get("nearest_margin_m")
    if near is not None and margin_m is not None:
        covers = f"in range of {near}" if margin_m >= 0.0 else f"{-margin_m:.0f} m out of range of {near}, the nearest"
        parts.append(covers)
        closes = lapse.get("closes_m_s")
        if margin_m < 0.0 and closes is not None:
            coming = f"coming back at {closes:.1f} m/s" if closes > 0.2 else f"going away at {-closes:.1f} m/s"
            parts.append(coming if abs(closes) > 0.2 else "not coming closer")
    if lapse.get("then"):
        parts.append(f"{clock(lapse['until_in_s'])} in this mode, {lapse['then']}")
    if lapse.get("resuming"):
        parts.append("coming back in")
    if lapse.get("resume_blocked"):
        parts.append(f"no resume now: {lapse['resume_blocked']}")
    parts.append(f"it takes: {lapse.get('commands', 'land, abort')} (skyrelay flight ID COMMAND)")
    return "; ".join(parts)


class FlightView:
    """Shows a flight's events as they come. Called from one thread."""

    def __init__(self, plan: Plan, progress: Progress) -> None:
        self._plan_time_s = plan.mission_time_s
        self._progress = progress
        self.failed_checks: list[dict[str, Any]] = []
        self.reason = ""
        """Why the flight is in the state it is in."""
        self.ended_why = ""
        """Why it ended; empty while it has not been told that it has."""
        self.not_planned: list[str] = []
        """What was told of the flight that a flight as planned does not have."""

    def __call__(self, event: FlightEvent) -> None:
        """Show one event."""
        self.show(event.kind.value, event.t_plus_s, event.state.value, event.data)

    def show(self, kind: str, t_plus_s: float | None, state: str, data: Any) -> None:
        """Show one event given by its parts, as the service sends them."""
        if kind == "progress":
            self._progress.show(self.where(t_plus_s, state, data))
            return
        text = self._line(kind, state, data)
        if text is not None:
            at = "        " if t_plus_s is None else f"T+ {clock(t_plus_s)}"
            self._progress.note(f"{at:<11} {text}")

    def where(self, t_plus_s: float | None, state: str, data: Any) -> str:
        """The flight now, in one line; who is in control comes first."""
        station = Sender.from_text(str(data.get("station") or "nobody")).station_id
        parts = [f"{station} in control"]
        if t_plus_s is None:
            parts.append(state_text(state))
        else:
            whole = f" of {clock(self._plan_time_s)}" if t_plus_s <= self._plan_time_s else ""
            parts.append(f"T+ {clock(t_plus_s)}{whole}")
            if state != "cruise":
                parts.append(state_text(state))
        if state == "lapsed" and data.get("lapse"):
            return ", ".join([*parts, lapse_text(data["lapse"])])
        if data.get("speed_m_s") is not None:
            parts.append(f"{data['speed_m_s']:.1f} m/s")
        if data.get("error_m") is not None and state in _ON_THE_PATH:
            parts.append(f"{data['error_m']:.1f} m off the plan")
        if data.get("margin_m") is not None:
            margin_m = data["margin_m"]
            parts.append(f"{margin_m:.0f} m of range left" if margin_m >= 0.0 else f"{-margin_m:.0f} m OUT OF RANGE")
        upcoming = data.get("handovers") or []
        if upcoming and t_plus_s is not None and state == "cruise":
            wait = clock(max(0.0, upcoming[0]["t_plus_s"] - t_plus_s))
            parts.append(f"{upcoming[0]['to']} takes over in {wait}")
        return ", ".join(parts)

    def _line(self, kind: str, state: str, data: Any) -> str | None:
        if kind == "state":
            self.reason = str(data.get("reason") or "")
            self.ended_why = self.reason if FlightState(data["to"]).ended else ""
            if data["to"] == "preflight":
                self.failed_checks.clear()
            if data["to"] == "refused" and self.failed_checks:
                # Every one of them has its own line, and they are told again at the end.
                return "refused: the preflight failed"
            to = state_text(data["to"])
            return f"{to} ({self.reason})" if self.reason else to
        if kind == "check" and data["level"] != "pass":
            required = f"; required: {data['required']}" if data.get("required") else ""
            if data["level"] != "warning":
                self.failed_checks.append(dict(data))
            fix = f"; {data['fix']}" if data.get("fix") else ""
            return f"preflight {data['level']}: {data['name']}: {data['message']}{required}{fix}"
        if kind == "handover" and data["state"] in _WORTH_TELLING:
            reason = f" ({data['reason']})" if data.get("reason") and data["state"] != "released" else ""
            return f"handover {data['index']}, {data['from']} to {data['to']}: {_DONE[data['state']]}{reason}"
        if kind == "alarm" and data["what"] == "lost C2 link":
            return f"lost C2 link: {lapse_text(data)}"
        if kind == "alarm":
            more = ", ".join(f"{k} {v}" for k, v in data.items() if k != "what")
            return f"ALARM: {data['what']}" + (f" ({more})" if more else "")
        if kind == "link":
            return f"{data['station']} now sends over {data['url']} instead of {data['before']}"
        if kind == "replanned":
            return f"a new plan is flown, {clock(data['mission_time_s'])} in all"
        if kind == "parameter":
            was = "" if data["before"] is None else f", was {data['before']}"
            done = "could not be set" if data["after"] is None else f"set to {data['after']}"
            return f"parameter {data['name']} {done}{was}"
        if kind == "text":
            return f"vehicle says: {data['text']}"
        if kind == "word":
            if data["word"] in _NOT_PLANNED:
                self.not_planned.append(f"'{data['word']}' was commanded")
            return f"operator command: {data['word']}"
        return None


def _link_lines(link: Any) -> list[str]:
    """One link's figures, or a line for each of a station's several."""
    lines = []
    for way in link.get("ways") or [link]:
        if way.get("round_trip_ms") is None:
            lines.append(f" ({way['url']}): never answered")
            continue
        sends = " (sends)" if way.get("sends") else ""
        lines.append(
            f" ({way['url']}){sends}: {100.0 * (way['loss'] or 0.0):.1f} % of frames lost, "
            f"{100.0 * (way['round_loss'] or 0.0):.1f} % of probes, "
            f"latency {way['latency_ms']:.0f} ms, jitter {way['jitter_ms']:.0f} ms"
        )
    return lines


def result_lines(
    plan: Plan, result: FlightResult, log: str | None = None, not_planned: Sequence[str] = ()
) -> list[str]:
    """How a flight went, for people; ``not_planned``: what was told that a flight as planned does not have."""
    summary = result.summary
    completed = result.exit_code == 0
    worst_m = summary.get("tracking_worst_m") or 0.0
    told = [*dict.fromkeys(not_planned)]
    if worst_m > FAR_OFF_PLAN_M:
        told.append(f"up to {worst_m:.1f} m from where the plan had it")
    late_s = summary.get("late_s")
    if late_s is not None and late_s > LATE_S:
        told.append(f"{late_s:.1f} s late")
    if completed and result.state.value == "completed":
        ended = f"arrived, not as planned: {', '.join(told)}" if told else "arrived, flown as planned"
    else:
        ended = state_text(result.state.value) + (f": {result.reason}" if result.reason else "")
    lines = [f"flight report: {ended}"]
    flown = summary.get("flown_s")
    if flown is not None:
        lines.append(
            f"  flown         {clock(flown)} from T+0 to the end, landing included (plan {clock(plan.mission_time_s)})"
        )
    if "handovers" in summary:
        back = summary.get("handovers_back") or 0
        along = f"{summary['handovers'] - back} of {len(plan.handovers)}"
        lines.append(f"  handovers     {along}" + (f", and {back} on the way back" if back else ""))
    if summary.get("setpoints"):
        lines.append(
            f"  tracking      {summary['tracking_rms_m']:.2f} m rms, {summary['tracking_worst_m']:.2f} m at worst"
        )
        lines.append(f"  setpoints     {summary['setpoints']} sent")
    lateness = summary.get("lateness")
    if lateness:
        lines.append(
            f"  stream        late by {lateness['p50_ms']:.1f} ms (median), {lateness['p99_ms']:.1f} ms (99 %), "
            f"{lateness['worst_ms']:.1f} ms at worst"
        )
    for station, link in (summary.get("links") or {}).items():
        lines += [f"  link          {station}{text}" for text in _link_lines(link)]
    if log:
        lines.append(f"  log           {log}")
    return lines
