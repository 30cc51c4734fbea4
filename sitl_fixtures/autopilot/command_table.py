"""The commands both autopilots know, and how they are answered.

The numbers are the same, most effects too. What differs is what stands in a subclass: the results of a refusal, whether
the acknowledgement comes before what was asked for or after it, and every text.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import ClassVar, Generic, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sitl_fixtures.autopilot.command import ACCEPTED, FORCE_DISARM, UNSUPPORTED, Command
from sitl_fixtures.autopilot.model import AutopilotModel
from sitl_fixtures.mavlink.wire import Message

Model = TypeVar("Model", bound=AutopilotModel)
Mode = TypeVar("Mode")


class CommandTable(ABC, Generic[Model, Mode]):
    """Handlers by command number.

    Args:
        autopilot: whose commands they are.
        mode_commands: the commands that only change the mode, each with that mode.
    """

    ACK_FIRST: ClassVar[bool]
    """Whether a message asked for comes after its acknowledgement."""
    UNKNOWN_MESSAGE: ClassVar[int]
    """Result of SET_MESSAGE_INTERVAL for a message unknown here."""
    REBOOT_REFUSED: ClassVar[int]
    """Result of a reboot that is refused."""

    def __init__(self, autopilot: Model, mode_commands: Mapping[int, Mode]) -> None:
        self._autopilot = autopilot
        self.commands: dict[int, Callable[[Command], None]] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._capabilities,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_CHANGE_SPEED: self._accept,
            mavlink.MAV_CMD_DO_SET_HOME: self._set_home,
            mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: self._reboot,
            mavlink.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            **{number: partial(self._mode_command, mode) for number, mode in mode_commands.items()},
        }

    def handle(self, command: Command) -> None:
        """Answers every command addressed to it; unknown ones are unsupported."""
        handler = self.commands.get(command.number)
        if handler is None:
            self._autopilot.ack(command, UNSUPPORTED)
        else:
            handler(command)

    # -- each autopilot its own ---------------------------------------------------------------------------------------

    @abstractmethod
    def _mode_command(self, mode: Mode, command: Command) -> None:
        """A command that only changes the mode."""

    @abstractmethod
    def _do_set_mode(self, command: Command) -> None: ...

    @abstractmethod
    def _takeoff(self, command: Command) -> None: ...

    @abstractmethod
    def _reposition(self, command: Command) -> None: ...

    @abstractmethod
    def _terminate(self, command: Command) -> None: ...

    @abstractmethod
    def _disarm(self, command: Command) -> None:
        """Disarms where it is allowed, armed or not, and acknowledges."""

    @abstractmethod
    def _refuse_disarming(self, command: Command) -> None: ...

    @abstractmethod
    def _refuse_arming(self, command: Command, reasons: list[str]) -> None: ...

    @abstractmethod
    def _tell_armed(self) -> None:
        """What is said after the acknowledgement of arming."""

    @abstractmethod
    def _request_result(self, number: int, message: Message | None) -> int:
        """Result of a REQUEST_MESSAGE; ``message`` is what there is to send."""

    @abstractmethod
    def _refuses_reboot(self, command: Command) -> bool: ...

    # -- the same -----------------------------------------------------------------------------------------------------

    def _answer(self, command: Command, result: int, message: Message | None) -> None:
        """The acknowledgement, and the message asked for on the same link, in this autopilot's order."""
        if self.ACK_FIRST:
            self._autopilot.ack(command, result)
        if message is not None:
            self._autopilot.vehicle.send(message, command.link)
        if not self.ACK_FIRST:
            self._autopilot.ack(command, result)

    def _accept(self, command: Command) -> None:
        """Acknowledged, and nothing comes of it here."""
        self._autopilot.ack(command, ACCEPTED)

    def _arm_disarm(self, command: Command) -> None:
        autopilot = self._autopilot
        forced = command.params[1] == FORCE_DISARM
        if command.params[0] == 0.0:
            if autopilot.armed and not autopilot.vehicle.body.on_ground and not forced:
                self._refuse_disarming(command)
            else:
                self._disarm(command)
            return
        if command.params[0] != 1.0:
            autopilot.ack(command, UNSUPPORTED)
            return
        if autopilot.armed:
            autopilot.ack(command, ACCEPTED)
            return
        reasons = [] if forced else autopilot.arming_refusals()
        if reasons:
            self._refuse_arming(command, reasons)
            return
        autopilot.arm()
        autopilot.ack(command, ACCEPTED)
        self._tell_armed()

    def _set_interval(self, command: Command) -> None:
        telemetry = self._autopilot.vehicle.telemetry
        known = telemetry.request_interval(command.link, int(command.params[0]), command.params[1])
        self._autopilot.ack(command, ACCEPTED if known else self.UNKNOWN_MESSAGE)

    def _get_interval(self, command: Command) -> None:
        number = int(command.params[0])
        interval_s = self._autopilot.vehicle.telemetry.interval_s(command.link, number)
        interval_us = -1 if interval_s is None else round(interval_s * 1e6)
        self._answer(command, ACCEPTED, mavlink.MAVLink_message_interval_message(number, interval_us))

    def _request_message(self, command: Command) -> None:
        number = int(command.params[0])
        builder = self._autopilot.vehicle.telemetry.builders.get(number)
        message = builder() if builder else None
        self._answer(command, self._request_result(number, message), message)

    def _capabilities(self, command: Command) -> None:
        self._answer(command, ACCEPTED, self._autopilot.version())

    def _set_home(self, command: Command) -> None:
        if command.params[0] == 1.0:
            self._autopilot.set_home_here()
        else:
            self._autopilot.home = (command.params[4], command.params[5], command.params[6])
        self._autopilot.ack(command, ACCEPTED)

    def _reboot(self, command: Command) -> None:
        if self._refuses_reboot(command):
            self._autopilot.ack(command, self.REBOOT_REFUSED)
            return
        self._autopilot.ack(command, ACCEPTED)
        self._autopilot.vehicle.after(0.2, self._autopilot.vehicle.reboot)
