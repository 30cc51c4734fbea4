"""What a simulated vehicle is made from."""

from __future__ import annotations

import re
from dataclasses import dataclass

from sitl_fixtures.ardupilot.autopilot import ArduCopter
from sitl_fixtures.autopilot.model import AutopilotModel
from sitl_fixtures.errors import ConfigurationError
from sitl_fixtures.px4.autopilot import Px4

AUTOPILOT_MODELS: dict[str, type[AutopilotModel]] = {"px4": Px4, "ardupilot": ArduCopter}
DEFAULT_HOMES: dict[str, tuple[float, float, float]] = {
    "ardupilot": (-35.363262, 149.165237, 584.09),
    "px4": (47.397743, 8.545594, 488.6),
}


@dataclass(frozen=True, slots=True)
class SimulatorConfig:
    """What to simulate.

    Attributes:
        autopilot: ``px4`` or ``ardupilot``.
        home: latitude and longitude (degrees) and ground altitude AMSL (m); None: the autopilot's own default.
        links: how many links there are.
        system_id: the vehicle's own.
        speedup: factor reported in SIM_SPEEDUP; the clock itself is the caller's.
        parameters: ``NAME=VALUE`` overrides.
        faults: fault specifications, see ``faults/injection.py``.
        seed: for everything random.
        ready_after_s: vehicle seconds from boot to a usable position.
        tick_s: step of the simulation, s.
        max_speed_m_s: sets the drag so that level flight tops out there; None: the default drag.
        tilt_deg: largest lean; None: by the parameters.
        wind_n_m_s, wind_e_m_s: wind, the velocity of the air.
        firmware: ``4.6``: ArduCopter's older names for whom it hears, and no range of them; empty: the newest.
        uid: the board's unique id, hex digits, at most 36; ``none``: it tells none; empty: one of its own, another in
            every simulator.
        speaks_operator_control: CONTROL_STATUS and command 32100, which no stock autopilot has.
        setpoint_log: how many obeyed set-points to keep for inspection.
    """

    autopilot: str = "px4"
    home: tuple[float, float, float] | None = None
    links: int = 1
    system_id: int = 1
    speedup: float = 1.0
    parameters: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    seed: int = 0
    ready_after_s: float = 2.0
    tick_s: float = 0.01
    max_speed_m_s: float | None = None
    tilt_deg: float | None = None
    wind_n_m_s: float = 0.0
    wind_e_m_s: float = 0.0
    firmware: str = ""
    uid: str = ""
    speaks_operator_control: bool = False
    setpoint_log: int = 200_000

    def __post_init__(self) -> None:
        if self.autopilot not in AUTOPILOT_MODELS:
            raise ConfigurationError("--autopilot", self.autopilot, "px4 or ardupilot", "choose one of them")
        if self.firmware and (self.autopilot, self.firmware) != ("ardupilot", "4.6"):
            raise ConfigurationError("--firmware", self.firmware, "4.6, with --autopilot ardupilot", "leave it out")
        if self.uid not in ("", "none") and not re.fullmatch("(?:[0-9a-fA-F]{2}){1,18}", self.uid):
            raise ConfigurationError("--uid", self.uid, "1 to 18 bytes as hex digits, or none", "correct it")
        if self.home is not None:
            lat, lon, alt = self.home
            if not (-89.0 <= lat <= 89.0 and -180.0 <= lon <= 180.0 and -500.0 <= alt <= 9000.0):
                raise ConfigurationError(
                    "--home", self.home, "latitude -89..89, longitude -180..180, altitude -500..9000 m", "correct it"
                )
        for where, value, low, high in (
            ("--system-id", self.system_id, 1, 254),
            ("--speedup", self.speedup, 0.01, 1000.0),
            ("--ready-after", self.ready_after_s, 0.0, 3600.0),
            ("tick_s", self.tick_s, 0.001, 0.05),
            ("--max-speed", 10.0 if self.max_speed_m_s is None else self.max_speed_m_s, 1.0, 200.0),
            ("--tilt", 45.0 if self.tilt_deg is None else self.tilt_deg, 5.0, 70.0),
            ("links", self.links, 1, 32),
            ("setpoint_log", self.setpoint_log, 2, 10_000_000),
        ):
            if not low <= value <= high:
                raise ConfigurationError(where, value, f"{low:g} to {high:g}", "choose a value in that range")
