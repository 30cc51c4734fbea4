"""Commands with an answer: sent, sent again with ``confirmation`` + 1, given up, or refused in the vehicle's words.

The MAVLink command protocol: a COMMAND_LONG is repeated until its COMMAND_ACK comes; IN_PROGRESS lengthens the wait;
TEMPORARILY_REJECTED, DENIED, UNSUPPORTED and FAILED are answers too. An ack says that the command was taken, not that
it had its effect (PX4 acknowledges OFFBOARD and stays where it is), so whoever asks still looks at the HEARTBEAT.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from link.dialect import mavlink
from link.errors import GateClosed
from link.transport.gate import ControlGrant

RETRY_S = 0.5
ATTEMPTS = 6
IN_PROGRESS_S = 5.0

RESULT_NAMES = {number: entry.name.removeprefix("MAV_RESULT_") for number, entry in mavlink.enums["MAV_RESULT"].items()}


def result_name(result: int) -> str:
    """The name of a MAV_RESULT, or its number."""
    return str(RESULT_NAMES.get(result, result))


@dataclass
class Ticket:
    """One command under way, and its outcome.

    ``result`` is the MAV_RESULT once ``finished``, None when no answer came or control was lost meanwhile
    (``outcome`` says which).
    """

    name: str
    command: int
    grant: ControlGrant
    params: tuple[float, ...]
    target_system: int
    target_component: int
    retry_s: float
    attempts: int
    sent: int = 0
    next_s: float = 0.0
    finished: bool = False
    result: int | None = None
    outcome: str = "waiting"
    progress: list[int] = field(default_factory=list)

    @property
    def accepted(self) -> bool:
        """Whether the vehicle said yes."""
        return bool(self.result == mavlink.MAV_RESULT_ACCEPTED)

    def message(self) -> Any:
        """The COMMAND_LONG of this attempt."""
        params = (*self.params, *(0.0,) * (7 - len(self.params)))
        return mavlink.MAVLink_command_long_message(
            self.target_system, self.target_component, self.command, min(self.sent, 255), *params
        )


class Commander:
    """Commands under way, at most one of a kind. ``send`` is the gate's, ``system_ids`` of the stations are by id."""

    def __init__(self, send: Callable[[ControlGrant, Any], object], system_ids: dict[str, int]) -> None:
        self._send = send
        self._system_ids = system_ids
        self._tickets: dict[int, Ticket] = {}
        self._sent_s: dict[int, float] = {}

    def start(
        self,
        now_s: float,
        grant: ControlGrant,
        name: str,
        command: int,
        params: tuple[float, ...] = (),
        *,
        target_system: int,
        target_component: int = 1,
        retry_s: float = RETRY_S,
        attempts: int = ATTEMPTS,
    ) -> Ticket:
        """Send ``command`` under ``grant`` and keep asking. A command of the same number under way is given up."""
        before = self._tickets.pop(command, None)
        if before is not None:
            self._finish(before, None, "replaced")
        ticket = Ticket(name, command, grant, params, target_system, target_component, retry_s, attempts)
        self._tickets[command] = ticket
        self._attempt(now_s, ticket)
        return ticket

    def waits_for(self, command: int) -> bool:
        """Whether a command of this number is under way."""
        return command in self._tickets

    def sent_s(self, command: int) -> float:
        """When a command of this number last left; minus infinity for never."""
        return self._sent_s.get(command, -math.inf)

    def cancel(self, ticket: Ticket) -> None:
        """Stop asking."""
        if self._tickets.get(ticket.command) is ticket:
            del self._tickets[ticket.command]
        if not ticket.finished:
            self._finish(ticket, None, "cancelled")

    def cancel_all(self) -> None:
        """Stop asking for anything: what was asked before must not come about after."""
        for ticket in list(self._tickets.values()):
            self.cancel(ticket)

    def on_ack(self, now_s: float, ack: Any) -> Ticket | None:
        """Take a COMMAND_ACK of the vehicle; the ticket it belongs to, None when it answers nothing we wait for.

        An ack addressed to another station is another's. Zero (an old peer that does not address) is everybody's.
        """
        ticket = self._tickets.get(ack.command)
        if ticket is None or ack.target_system not in (0, self._own_id(ticket)):
            return None
        if ack.result == mavlink.MAV_RESULT_IN_PROGRESS:
            ticket.progress.append(int(ack.progress))
            ticket.next_s = max(ticket.next_s, now_s + IN_PROGRESS_S)
            return ticket
        del self._tickets[ack.command]
        self._finish(ticket, int(ack.result), result_name(ack.result))
        return ticket

    def _own_id(self, ticket: Ticket) -> int:
        """The system id a command was sent under, which its answer is addressed to."""
        sender = ticket.grant.sender
        return ticket.target_system if sender.as_vehicle else self._system_ids[sender.station_id]

    def step(self, now_s: float) -> None:
        """Repeat what is due; give up what was asked often enough."""
        for ticket in list(self._tickets.values()):
            if now_s < ticket.next_s:
                continue
            if ticket.sent >= ticket.attempts:
                del self._tickets[ticket.command]
                self._finish(ticket, None, "no answer")
            else:
                self._attempt(now_s, ticket)

    def _attempt(self, now_s: float, ticket: Ticket) -> None:
        try:
            self._send(ticket.grant, ticket.message())
        except GateClosed:
            self._tickets.pop(ticket.command, None)
            self._finish(ticket, None, "control moved on")
            return
        ticket.sent += 1
        self._sent_s[ticket.command] = now_s
        ticket.next_s = now_s + ticket.retry_s

    @staticmethod
    def _finish(ticket: Ticket, result: int | None, outcome: str) -> None:
        ticket.finished, ticket.result, ticket.outcome = True, result, outcome
