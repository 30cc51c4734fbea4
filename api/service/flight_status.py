"""What a flight's events amount to, for people to look at: state, preflight, where it is, how it ended. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from gcs.flight import EventKind, FlightEvent, FlightState
from link.transport import Sender

# Nothing is armed in these: to the outside one state, `preflight`.
ON_THE_GROUND = (FlightState.CONNECTING, FlightState.IDENTIFYING, FlightState.PREFLIGHT, FlightState.READY)
_MOST_ALARMS = 50


def outer_state(state: FlightState) -> str:
    """The state as the outside knows it: ``preflight`` until the launch command."""
    return FlightState.PREFLIGHT.value if state in ON_THE_GROUND else state.value


@dataclass
class FlightStatus:
    """What the events so far amount to. `apply` each in order."""

    state: FlightState = FlightState.CONNECTING
    sequence: int = 0
    preflight_id: int | None = None
    checks: list[dict[str, Any]] = field(default_factory=list)
    alarms: list[dict[str, Any]] = field(default_factory=list)
    handovers: dict[int, str] = field(default_factory=dict)
    schedule: list[dict[str, Any]] = field(default_factory=list)
    shift_s: float = 0.0
    position: dict[str, Any] = field(default_factory=dict)
    station: str | None = None
    t_plus_s: float | None = None
    utc: str | None = None
    ended_utc: str | None = None
    result: dict[str, Any] | None = None
    reason: str = ""
    plan_sha256: str | None = None
    """Of the plan taken over in the air last; None while the first is flown."""

    def apply(self, event: FlightEvent) -> None:
        """Take one event."""
        data = dict(event.data)
        self.state, self.sequence = event.state, event.sequence
        self.t_plus_s, self.utc = event.t_plus_s, event.utc
        if event.state.ended:
            self.ended_utc = self.ended_utc or event.utc
        match event.kind:
            case EventKind.STATE:
                self.reason = str(data.get("reason") or "")
            case EventKind.CHECK:
                if data.get("preflight") != self.preflight_id:
                    self.preflight_id, self.checks = data.get("preflight"), []
                self.checks.append({k: v for k, v in data.items() if k != "preflight"})
            case EventKind.ALARM:
                self.alarms = [*self.alarms, {"utc": event.utc, "t_plus_s": event.t_plus_s, **data}][-_MOST_ALARMS:]
            case EventKind.GATE:
                self.station = _name(data.get("station"))
            case EventKind.HANDOVER:
                self.handovers[int(data["index"])] = str(data["state"])
            case EventKind.REPLANNED:
                self.plan_sha256 = str(data["plan_sha256"])
                # Handovers to come are other ones now, whatever their numbers.
                done = int(data["handovers_done"])
                self.handovers = {index: state for index, state in self.handovers.items() if index <= done}
            case EventKind.RETIMED:
                self.schedule, self.shift_s = list(data["handovers"]), float(data["shift_s"])
            case EventKind.PROGRESS:
                self.position = data
                self.station = _name(data.get("station"))
            case EventKind.RESULT:
                self.result = data
            case _:
                pass

    @property
    def passed(self) -> bool:
        """Whether the last preflight passed: nothing failed, and the flight got as far as ready."""
        ready = self.state is FlightState.READY or self.state not in ON_THE_GROUND
        return ready and self.state is not FlightState.REFUSED and self.preflight_id is not None

    def live(self) -> dict[str, Any]:
        """The flight now, for the telemetry socket and the page."""
        here = self.position
        upcoming = [h for h in self.schedule if self.t_plus_s is not None and h["t_plus_s"] > self.t_plus_s]
        following = None
        # Standing, or off the plan, no time can be given for it.
        if upcoming and self.state is FlightState.CRUISE and self.t_plus_s is not None:
            following = {**upcoming[0], "in_s": upcoming[0]["t_plus_s"] - self.t_plus_s}
        placed = here.get("lat_deg") is not None
        return {
            "state": outer_state(self.state),
            "phase": self.state.value,
            "reason": self.reason,
            "t_plus_s": self.t_plus_s,
            "utc": self.utc,
            "station": self.station,
            "plan_s": here.get("plan_s"),
            "replanned_sha256": self.plan_sha256,
            "position": {k: here[k] for k in ("lat_deg", "lon_deg", "alt_amsl_m")} if placed else None,
            "speed_m_s": here.get("speed_m_s"),
            "velocity_ned_m_s": here.get("velocity_ned_m_s"),
            "error_m": here.get("error_m"),
            "margin_m": here.get("margin_m"),
            "battery_percent": here.get("battery_percent"),
            "links": here.get("links"),
            "lapse": here.get("lapse") if self.state is FlightState.LAPSED else None,
            "next_handover": following,
            "handovers": upcoming,
            "shift_s": self.shift_s,
            "outcome": (self.result or {}).get("outcome"),
        }


def _name(station: object) -> str | None:
    # Under whichever id it speaks.
    return None if station is None else Sender.from_text(str(station)).station_id
