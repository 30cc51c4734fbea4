"""What the parts of a flight share: the request, the wire, the clock of this step, and the way to tell people."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gcs.flight import EventKind, FlightEvent, FlightState, advance
from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.profile import AutopilotProfile
from link.clock import UtcScale
from link.dialect import mavlink
from link.microservices.command import Commander, Ticket
from link.session.request import FlightRequest
from link.setpoints.local_projection import LocalMap
from link.setpoints.setpoint import Setpoint
from link.telemetry.setpoint_echo import EchoTracker, Sent
from link.telemetry.vehicle_monitor import VehicleMonitor
from link.transport.gate import ControlGrant, Sender, TransmitterGate

if TYPE_CHECKING:
    from link.handover.gcs_ownership import Keeper


def plain(value: Any) -> Any:
    """The same with None for every number that is not finite: events are JSON, and a vehicle may say NaN."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    return value


@dataclass
class FlightContext:
    """One flight's shared parts. ``now_s`` is the flight's clock at this step."""

    request: FlightRequest
    plan: Plan
    profile: AutopilotProfile
    gate: TransmitterGate
    monitor: VehicleMonitor
    commander: Commander
    echoes: EchoTracker
    utc: UtcScale
    system_ids: Mapping[str, int]
    local: LocalMap
    now_s: float = 0.0
    state: FlightState = FlightState.CONNECTING
    launched_s: float | None = None
    """The flight's clock at T+0."""
    origin: EkfOrigin | None = None
    """The vehicle's EKF origin as the station in control was told it."""
    origin_s: float = -math.inf
    events: list[FlightEvent] = field(default_factory=list)
    setpoints_sent: int = 0
    last_setpoint_s: float = -math.inf
    last_setpoint: Setpoint | None = None
    keeper: Keeper | None = None
    """Moves ownership from station to station in flight, where that is how this vehicle is told of handovers."""
    _sequence: int = 0

    # -- people -------------------------------------------------------------------------------------------------------

    def emit(self, kind: EventKind, **data: Any) -> None:
        """Write an event."""
        self._sequence += 1
        t_plus = None if self.launched_s is None else round(self.now_s - self.launched_s, 6)
        utc = self.utc.text(self.now_s)
        self.events.append(
            FlightEvent(self._sequence, kind, round(self.now_s, 6), t_plus, utc, self.state, plain(data))
        )

    def alarm(self, what: str, **data: Any) -> None:
        """Something a person must know at once."""
        self.emit(EventKind.ALARM, what=what, **data)

    def become(self, state: FlightState, reason: str = "") -> None:
        """Change the flight's state. Raises `gcs.flight.TransitionError` where that cannot follow."""
        before, self.state = self.state, advance(self.state, state)
        self.emit(EventKind.STATE, **{"from": before.value, "to": state.value, "reason": reason})

    # -- the wire -----------------------------------------------------------------------------------------------------

    @property
    def vehicle(self) -> int:
        """The vehicle's system id."""
        return self.monitor.vehicle_system_id

    @property
    def in_force(self) -> ControlGrant:
        """The grant in force. Raises `RuntimeError` while nobody is in control: the caller must have granted."""
        grant = self.gate.in_force
        if grant is None:
            raise RuntimeError("nobody is in control")
        return grant

    @property
    def own_id(self) -> int:
        """The system id that is spoken with under the grant in force."""
        sender = self.in_force.sender
        return self.vehicle if sender.as_vehicle else self.system_ids[sender.station_id]

    @property
    def speaker(self) -> str | None:
        """Who is in control, as events tell it (`link.transport.gate.Sender`); None while nobody is."""
        grant = self.gate.in_force
        return None if grant is None else str(grant.sender)

    def grant(self, station_id: str, reason: str, *, as_vehicle: bool = False) -> None:
        """Move control to a station, at once, and say so; ``as_vehicle``: to speak with the vehicle's own id."""
        before = self.gate.in_force
        if before is not None and before.sender == Sender(station_id, as_vehicle):
            return
        told = self.speaker
        grant = self.gate.grant(station_id, as_vehicle=as_vehicle)
        self.emit(EventKind.GATE, fence=grant.number, station=self.speaker, before=told, reason=reason)

    def start_command(
        self, name: str, command: int, params: tuple[float, ...] = (), *, retry_s: float = 0.5, attempts: int = 6
    ) -> Ticket:
        """Send a command from the station in control."""
        return self.commander.start(
            self.now_s,
            self.in_force,
            name,
            command,
            params,
            target_system=self.vehicle,
            retry_s=retry_s,
            attempts=attempts,
        )

    def start_mode(self, mode: str) -> Ticket:
        """Ask for a flight mode by its name; only the HEARTBEAT tells whether it came."""
        return self.start_command(f"mode {mode}", mavlink.MAV_CMD_DO_SET_MODE, self.profile.set_mode_parameters(mode))

    def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send a setpoint from the station in control, and remember it. Raises `UnsafeSetpoint`, and sends nothing."""
        message = self.profile.encode(
            setpoint,
            target_system=self.vehicle,
            time_boot_ms=int(self.now_s * 1000.0) & 0xFFFFFFFF,
            origin=self.origin,
        )
        grant = self.in_force
        self.gate.send(grant, message)
        self.setpoints_sent += 1
        self.last_setpoint_s = self.now_s
        self.last_setpoint = setpoint
        if self.origin is not None:
            north, east = self.profile.north_east_m(self.origin, setpoint.lat_deg, setpoint.lon_deg)
            down = self.origin.alt_amsl_m - setpoint.alt_amsl_m
            self.echoes.note(
                Sent(
                    self.now_s,
                    grant.station_id,
                    grant.number,
                    (north, east, down),
                    setpoint.velocity_ned_m_s,
                    setpoint.acceleration_ned_m_s2,
                )
            )

    # -- the vehicle --------------------------------------------------------------------------------------------------

    @property
    def armed(self) -> bool:
        """Whether the last HEARTBEAT showed armed motors."""
        return self.monitor.heartbeat is not None and self.monitor.heartbeat.armed

    @property
    def on_ground(self) -> bool:
        """Whether the vehicle said it had landed."""
        return bool(self.monitor.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)

    @property
    def mode(self) -> str | None:
        """Mode of the last HEARTBEAT, by name."""
        return None if self.monitor.heartbeat is None else self.profile.mode_of(self.monitor.heartbeat)

    @property
    def follows(self) -> bool:
        """Whether the vehicle follows setpoints, by its HEARTBEAT."""
        return self.mode == self.profile.offboard_mode

    def adopt_origin(self, station_id: str) -> bool:
        """Take the EKF origin a station was told; whether it is another than before."""
        link = self.monitor.links[station_id]
        if link.origin is None or link.origin_s <= self.origin_s:
            return False
        changed = self.origin is not None and link.origin != self.origin
        self.origin, self.origin_s = link.origin, link.origin_s
        return changed

    def position_enu_m(self) -> tuple[float, float, float] | None:
        """Where the vehicle last said it was, in the plan's plane."""
        position = self.monitor.position
        if position is None:
            return None
        east, north = self.local.to_plane(position.lat_deg, position.lon_deg)
        return east, north, position.alt_amsl_m - self.plan.plane.alt_amsl_m
