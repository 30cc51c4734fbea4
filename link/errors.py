"""What the wire layer raises.

LinkError
├── EndpointError              a link could not be opened or is gone
│   └── EndpointUrlError       the URL itself is not one of ours (also ValueError)
├── UnsafeSetpoint             a setpoint that must never reach a vehicle (also ValueError)
├── MissingOrigin              local coordinates asked for before the vehicle told its EKF origin
├── SigningError               the signing state cannot be used safely
│   └── SigningKeyError        a key is missing, malformed or readable by others (also ValueError)
├── ParameterError             a parameter value does not fit its type, or a reply cannot be read (also ValueError)
├── MissionItemError           a mission item that no vehicle may be sent (also ValueError)
├── TlogError                  a telemetry log cannot be read or written
├── GateClosed                 control traffic from a station that is not in control
├── FlightRequestError         a flight that must not start as asked; lists every reason (also ValueError)
├── VehicleError               a vehicle outside any flight that does not answer, or must not be touched now
├── SupervisorError            the streamer process could not be started or reached
└── ReportError                a log that does not hold a flight of the plan (also ValueError)

Every message says what was wrong, the value, what is allowed and what to do.
"""

from __future__ import annotations

from collections.abc import Sequence

from gcs.errors import InputFault


class LinkError(Exception):
    """Base of everything the wire layer raises on purpose."""


class EndpointError(LinkError):
    """A link could not be opened: the address is taken, unknown or not permitted; says which and what to do."""


class EndpointUrlError(EndpointError, ValueError):
    """A link URL that does not follow the grammar; ``.url`` is what was given."""

    def __init__(self, url: str, problem: str) -> None:
        super().__init__(
            f"link URL {url!r}: {problem}; allowed are udpout:HOST:PORT, udpin:HOST:PORT, tcp:HOST:PORT "
            "and serial:DEVICE:BAUD"
        )
        self.url = url


class UnsafeSetpoint(LinkError, ValueError):  # noqa: N818 - it names the thing refused
    """A setpoint outside every bound a vehicle could mean; ``.field``, ``.value``, ``.allowed``.

    PX4 flies at full speed towards latitude 91 and ArduPilot takes NaN: nothing but this check stands before that.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        super().__init__(f"setpoint refused: {field} is {value}, allowed is {allowed}; nothing was sent")
        self.field = field
        self.value = value
        self.allowed = allowed


class MissingOrigin(LinkError):  # noqa: N818 - it names the thing that is missing
    """The autopilot's profile needs the EKF origin (GPS_GLOBAL_ORIGIN, message 49) and has none yet."""


class SigningError(LinkError):
    """The signing state cannot be used safely: its file is damaged, in use, or cannot be written."""


class SigningKeyError(SigningError, ValueError):
    """A signing key is missing, has the wrong length, or lies open to others. Never shows the key."""


class ParameterError(LinkError, ValueError):
    """A parameter value does not fit its type or its encoding."""


class MissionItemError(LinkError, ValueError):
    """A mission, fence or rally item that cannot be sent: which, its value, what is allowed."""


class TlogError(LinkError):
    """A telemetry log cannot be read or written; says which file and at which byte."""


class GateClosed(LinkError):  # noqa: N818 - it names what happened
    """Control traffic from a station that is not, or no longer, in control. Nothing was sent."""


class FlightRequestError(LinkError, ValueError):
    """A flight that must not start as asked; ``.problems`` lists every reason, each a `gcs.errors.InputFault`."""

    def __init__(self, problems: Sequence[InputFault]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n  ".join(["the flight cannot start as asked:", *(str(fault) for fault in problems)]))


class VehicleError(LinkError):
    """A vehicle, outside any flight, does not answer, or must not be changed now; says why and what to do."""


class SupervisorError(LinkError):
    """The streamer process could not be started, or a running one cannot be reached; says why."""


class ReportError(LinkError, ValueError):
    """A telemetry log does not hold a flight of the plan it is compared with; says what is missing."""
