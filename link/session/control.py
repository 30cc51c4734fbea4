"""What goes out to the vehicle: who may send, commands and modes, setpoints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from gcs.flight import EventKind
from link.dialect import mavlink
from link.microservices.command import Commander, Ticket
from link.session.timeline import Timeline
from link.session.vehicle import Vehicle
from link.setpoints.setpoint import Setpoint
from link.telemetry.setpoint_echo import EchoTracker, Sent
from link.transport.gate import ControlGrant, Sender, TransmitterGate


class IdManager(Protocol):
    """What a handover asks of the one who tells the vehicle whom to hear (`link.handover.gcs_ids.GcsIdManager`)."""

    claimed: str | None
    """The station that is to be heard alone before control moves, where the vehicle has no range."""

    @property
    def ranged(self) -> bool:
        """Whether two stations can be heard at once."""
        ...

    def hears(self, station_id: str) -> bool:
        """Whether the vehicle surely obeys a station."""
        ...

    def step(self, now_s: float) -> None:
        """Write what is due."""
        ...

    def on_value(self, name: str, value: float) -> None:
        """Take a parameter's value the vehicle told."""
        ...


@dataclass
class Control:
    """Everything sent in control of the vehicle, by the station that has it. ``system_ids`` are the stations'."""

    timeline: Timeline
    vehicle: Vehicle
    gate: TransmitterGate
    commander: Commander
    echoes: EchoTracker
    system_ids: Mapping[str, int]
    id_manager: IdManager | None = None
    """Moves control in the vehicle's own parameters too, where that is how it is told of handovers."""
    setpoints_sent: int = 0
    last_setpoint_s: float = -math.inf

    # -- who may send -------------------------------------------------------------------------------------------------

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
        return self.vehicle.system_id if sender.as_vehicle else self.system_ids[sender.station_id]

    @property
    def speaker(self) -> str | None:
        """Who is in control, as events tell it (``str`` of a `Sender`); None while nobody is."""
        grant = self.gate.in_force
        return None if grant is None else str(grant.sender)

    def grant(self, station_id: str, reason: str, *, as_vehicle: bool = False) -> None:
        """Move control to a station, at once, and say so; ``as_vehicle``: to speak with the vehicle's own id."""
        before = self.gate.in_force
        if before is not None and before.sender == Sender(station_id, as_vehicle):
            return
        told = self.speaker
        grant = self.gate.grant(station_id, as_vehicle=as_vehicle)
        self.timeline.emit(EventKind.GATE, fence=grant.number, station=self.speaker, before=told, reason=reason)

    # -- what is sent -------------------------------------------------------------------------------------------------

    def start_command(
        self, name: str, command: int, params: tuple[float, ...] = (), *, retry_s: float = 0.5, attempts: int = 6
    ) -> Ticket:
        """Send a command from the station in control."""
        return self.commander.start(
            self.timeline.now_s,
            self.in_force,
            name,
            command,
            params,
            target_system=self.vehicle.system_id,
            retry_s=retry_s,
            attempts=attempts,
        )

    def start_mode(self, mode: str) -> Ticket:
        """Ask for a flight mode by its name; only the HEARTBEAT tells whether it came."""
        parameters = self.vehicle.profile.set_mode_parameters(mode)
        return self.start_command(f"mode {mode}", mavlink.MAV_CMD_DO_SET_MODE, parameters)

    def send_setpoint(self, setpoint: Setpoint) -> None:
        """Send a setpoint from the station in control, and remember it. Raises `UnsafeSetpoint`, and sends nothing."""
        now_s, profile, origin = self.timeline.now_s, self.vehicle.profile, self.vehicle.origin
        message = profile.encode(
            setpoint,
            target_system=self.vehicle.system_id,
            time_boot_ms=int(now_s * 1000.0) & 0xFFFFFFFF,
            origin=origin,
        )
        grant = self.in_force
        self.gate.send(grant, message)
        self.setpoints_sent += 1
        self.last_setpoint_s = now_s
        if origin is not None:
            north, east = profile.north_east_m(origin, setpoint.lat_deg, setpoint.lon_deg)
            down = origin.alt_amsl_m - setpoint.alt_amsl_m
            self.echoes.note(
                Sent(
                    now_s,
                    grant.station_id,
                    grant.number,
                    (north, east, down),
                    setpoint.velocity_ned_m_s,
                    setpoint.acceleration_ned_m_s2,
                )
            )
