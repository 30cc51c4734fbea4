"""MAVLink's mission microservice over the gate, one list transfer at a time.

What `link.microservices.mission_upload` wants is sent, what comes is passed on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from link.errors import GateClosed
from link.microservices.mission_download import MissionTransfer
from link.transport.gate import ControlGrant


class MissionClient:
    """Runs transfers of one flight. ``send`` is the gate's."""

    def __init__(self, send: Callable[[ControlGrant, Any], object]) -> None:
        self._send = send
        self._grant: ControlGrant | None = None
        self._transfer: MissionTransfer | None = None

    def start(self, now_s: float, grant: ControlGrant, transfer: MissionTransfer) -> None:
        """Begin a transfer under a grant; one that is under way is cancelled."""
        if self._transfer is not None:
            self._transfer.cancel()
            self._flush()
        self._grant, self._transfer = grant, transfer
        transfer.start(now_s)
        self._flush()

    def on_message(self, now_s: float, message: Any) -> None:
        """Take a message of the vehicle."""
        if self._transfer is not None:
            self._transfer.receive(message, now_s)
            self._flush()

    def step(self, now_s: float) -> None:
        """Let time pass."""
        if self._transfer is not None:
            self._transfer.step(now_s)
            self._flush()

    def _flush(self) -> None:
        transfer, grant = self._transfer, self._grant
        if transfer is None or grant is None:
            return
        try:
            for message in transfer.take_outgoing():
                self._send(grant, message)
        except GateClosed:
            # Control moved on: whatever the vehicle holds now, nobody may go on writing it.
            transfer.cancel()
            transfer.take_outgoing()
        if not transfer.running:
            self._transfer = None
