"""Which vehicle answers: autopilot, type, version."""

from __future__ import annotations

from dataclasses import dataclass

from link.autopilot.profile import AutopilotProfile
from link.preflight.check import Check, Level

_RELEASES = ((64, "dev"), (128, "alpha"), (192, "beta"), (255, "rc"))


@dataclass(frozen=True)
class Identity:
    """Who the vehicle says it is: AUTOPILOT_VERSION (148), or what another client read of it."""

    version: tuple[int, int, int]
    release: str
    git_hash: str
    board: str

    @property
    def text(self) -> str:
        """For people."""
        number = ".".join(map(str, self.version)) + (f"-{self.release}" if self.release else "")
        return f"{number}, git {self.git_hash or 'unknown'}, board {self.board or 'unknown'}"

    @classmethod
    def from_message(cls, message: object) -> Identity:
        """From AUTOPILOT_VERSION."""
        number = int(message.flight_sw_version)  # type: ignore[attr-defined]
        custom = bytes(message.flight_custom_version)  # type: ignore[attr-defined]
        board = int(message.board_version)  # type: ignore[attr-defined]
        ids = f"{int(message.vendor_id):04x}:{int(message.product_id):04x}"  # type: ignore[attr-defined]
        kind = number & 255
        release = next((name for below, name in _RELEASES if kind < below), "")
        # ArduPilot writes the hash as text, PX4 as a number, lowest byte first.
        as_text = custom.rstrip(b"\0")
        text = as_text.decode("ascii") if as_text.isascii() and as_text.isalnum() else custom[::-1].hex()
        return cls(
            (number >> 24 & 255, number >> 16 & 255, number >> 8 & 255),
            release,
            text if any(custom) else "",
            f"{board >> 16 or board} ({ids})" if board or any(c != "0" for c in ids if c != ":") else "",
        )


def judge_identity(profile: AutopilotProfile, identity: Identity | None, vehicle_type: int | None) -> list[Check]:
    """Findings about who the vehicle is; ``vehicle_type`` is the MAV_TYPE of its HEARTBEAT."""
    oldest = ".".join(map(str, profile.oldest_firmware))
    required = f"{profile.title} {oldest} or newer"
    if identity is None:
        message = f"{profile.title}; it does not tell its version"
        check = Check("vehicle", Level.WARNING, message, None, required, fix="look up its firmware before you fly")
    else:
        old = identity.version[:2] < profile.oldest_firmware
        message = f"{profile.title} {identity.text}" + ("; older than what this was made for" if old else "")
        level = Level.WARNING if old else Level.PASS
        check = Check("vehicle", level, message, ".".join(map(str, identity.version)), required, fix="update it")
    if vehicle_type is None:
        return [check]
    fit = vehicle_type in profile.airframes
    return [
        check,
        Check(
            "vehicle type",
            Level.PASS if fit else Level.FAILURE,
            f"MAV_TYPE {vehicle_type} " + ("can hover" if fit else "is no multicopter"),
            vehicle_type,
            "a vehicle that hovers and takes position setpoints",
            fix="fly a multicopter",
        ),
    ]
