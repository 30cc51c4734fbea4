"""What must hold before anything is armed, judged from what was read back.

Both autopilots ship with their failsafes off or meaningless for a flight without a pilot's radio; a flight that depends
on them is refused until they read back as required. Every finding says what was found, what is required and
what to do; the worst level decides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from gcs.plan import Plan
from link.params import Parameter
from link.profiles import AutopilotProfile
from link.request import FlightRequest

GRAVITY_M_S2 = 9.80665
MIN_START_HEIGHT_M = 3.0
"""The plan's start must be this far above the vehicle's ground: below it a take-off is no take-off."""
BATTERY_LOW_PERCENT = 30


class Level(IntEnum):
    """How bad a finding is."""

    PASS = 0
    WARNING = 1
    FAILURE = 2


@dataclass(frozen=True)
class Check:
    """One finding. ``set`` is the remedy where it is one parameter: its name on this vehicle and the value."""

    name: str
    level: Level
    message: str
    value: object = None
    required: str = ""
    set: tuple[str, int | float] | None = None

    def to_document(self) -> dict[str, object]:
        """As a JSON object."""
        return {
            "name": self.name,
            "level": self.level.name.lower(),
            "message": self.message,
            "value": self.value,
            "required": self.required,
            "set": None if self.set is None else {"name": self.set[0], "value": self.set[1]},
        }


@dataclass(frozen=True)
class Rule:
    """What one parameter must be. ``fix`` makes the value to set of the one found, None where a person decides."""

    key: str
    holds: Callable[[float], bool]
    required: str
    why: str
    fix: Callable[[float], int | float] | None = None
    level: Level = Level.FAILURE


def _rules_px4(request: FlightRequest, values: Mapping[str, Parameter | None]) -> list[Rule]:
    least = max(0.3, 4.0 / request.rate_hz)
    pilot = values.get("rc_input_mode")
    rules = [
        Rule(
            "offboard_loss_timeout",
            lambda v: least <= v <= 5.0,
            f"{least:g} to 5 s",
            "how long the stream may be silent before the vehicle acts",
            lambda v: 1.0,
        ),
        Rule(
            "offboard_loss_action",
            lambda v: v in (3, 4, 5),
            "3 (return), 4 (land) or 5 (hold)",
            "what it does when the stream stops; the rest needs a pilot's radio or drops the vehicle",
            lambda v: 5,
        ),
        Rule(
            "data_link_loss_action",
            lambda v: v in (1, 2, 3),
            "1 (hold), 2 (return) or 3 (land)",
            "what it does when every station falls silent",
            lambda v: 2,
        ),
        Rule("data_link_loss_timeout", lambda v: 3 <= v <= 60, "3 to 60 s", "how long until that", lambda v: 10),
    ]
    if pilot is None or pilot.value != 4:
        rules.append(
            Rule(
                "rc_loss_exceptions",
                lambda v: bool(int(v) & 4),
                "bit 2 (offboard) set",
                "without a pilot's radio its loss would end the flight",
                lambda v: int(v) | 4,
            )
        )
    return rules


def _rules_ardupilot(request: FlightRequest, values: Mapping[str, Parameter | None]) -> list[Rule]:
    least = max(0.3, 4.0 / request.rate_hz)
    return [
        Rule(
            "offboard_loss_timeout",
            lambda v: least <= v <= 3.0,
            f"{least:g} to 3 s",
            "how long the vehicle runs on along its last velocity when the stream stops",
            lambda v: 3.0,
        ),
        Rule(
            "gcs_failsafe",
            lambda v: v in (1, 3, 4, 5, 6, 7),
            "1 (return) or 3 to 7",
            "what it does when the owner's heartbeat stops",
            lambda v: 1,
        ),
        Rule("gcs_failsafe_timeout", lambda v: 2 <= v <= 30, "2 to 30 s", "how long until that", lambda v: 5),
        Rule(
            "failsafe_options",
            lambda v: bool(int(v) & 4),
            "bit 2 set where a pilot's radio is fitted",
            "else the loss of that radio ends GUIDED",
            level=Level.WARNING,
        ),
    ]


def judge_parameters(
    profile: AutopilotProfile, values: Mapping[str, Parameter | None], request: FlightRequest
) -> list[Check]:
    """Findings about the parameters; ``values`` by `ParameterName.key`, None where the vehicle knows no such name."""
    rules = _rules_px4(request, values) if profile.name == "px4" else _rules_ardupilot(request, values)
    checks = []
    for rule in rules:
        parameter = values.get(rule.key)
        if parameter is None:
            names = " or ".join(profile.parameter(rule.key).names)
            checks.append(Check(names, rule.level, f"not known to the vehicle: {rule.why}", None, rule.required))
        elif math.isfinite(parameter.value) and rule.holds(parameter.value):
            checks.append(Check(parameter.name, Level.PASS, rule.why, parameter.value, rule.required))
        else:
            value = parameter.value if math.isfinite(parameter.value) else 0.0
            remedy = None if rule.fix is None else (parameter.name, rule.fix(value))
            shown = parameter.value if math.isfinite(parameter.value) else str(parameter.value)
            checks.append(Check(parameter.name, rule.level, f"unsafe: {rule.why}", shown, rule.required, remedy))
    return checks


def judge_performance(profile: AutopilotProfile, values: Mapping[str, Parameter | None], plan: Plan) -> list[Check]:
    """Findings about what the plan asks of the vehicle: speed, climb and lean against its own limits."""
    checks = []
    times = np.linspace(0.0, plan.trajectory.duration_s, max(2, math.ceil(plan.trajectory.duration_s / 0.5)))
    velocity = plan.trajectory.evaluate(times, 1)
    speed = float(np.hypot(velocity[:, 0], velocity[:, 1]).max())
    climb, descent = float(velocity[:, 2].max()), float(-velocity[:, 2].min())
    binding = profile.name == "px4"
    for key, asked, what, level in (
        ("max_speed", speed, "horizontal speed", Level.FAILURE),
        ("max_climb", climb, "climb", Level.WARNING),
        ("max_descent", descent, "descent", Level.WARNING),
    ):
        parameter = values.get(key)
        # ArduPilot's own navigation speeds do not bound position targets; its lean does.
        if parameter is None or not binding:
            continue
        fits = asked <= float(parameter.value) * 1.001
        message = f"the plan's top {what} is {asked:.2f} m/s" + ("" if fits else "; the vehicle would fall behind")
        checks.append(
            Check(
                parameter.name,
                Level.PASS if fits else level,
                message,
                parameter.value,
                f"at least {asked:.2f} m/s, or a slower plan",
            )
        )
    tilt = values.get("max_tilt")
    if tilt is not None:
        degrees = float(tilt.value) * (0.01 if profile.name == "ardupilot" else 1.0)
        possible = GRAVITY_M_S2 * math.tan(math.radians(min(degrees, 80.0)))
        needed = plan.mission.limits.max_accel_m_s2
        level = Level.PASS if needed <= 0.8 * possible else Level.WARNING if needed <= possible else Level.FAILURE
        message = f"{degrees:.0f} degrees of lean give {possible:.1f} m/s^2, drag included; the plan asks {needed:g}"
        checks.append(Check(tilt.name, level, message, tilt.value, f"room for {needed:g} m/s^2"))
    return checks


def judge_place(
    plan: Plan, position_enu_m: tuple[float, float, float], ground_amsl_m: float, request: FlightRequest
) -> list[Check]:
    """Findings about where the vehicle stands: ``position_enu_m`` in the plan's plane, its ground AMSL."""
    start = np.asarray(plan.trajectory.evaluate(0.0))
    here = np.array(position_enu_m)
    off_m = float(np.hypot(*(here - start)[:2]))
    checks = [
        Check(
            "transit",
            Level.PASS if off_m <= request.max_transit_m else Level.FAILURE,
            f"the vehicle is {off_m:.1f} m from the plan's start",
            round(off_m, 1),
            f"at most {request.max_transit_m:g} m",
        )
    ]
    height_m = float(start[2]) + plan.plane.alt_amsl_m - ground_amsl_m
    checks.append(
        Check(
            "start height",
            Level.PASS if height_m >= MIN_START_HEIGHT_M else Level.FAILURE,
            f"the plan starts {height_m:.1f} m above the vehicle's ground ({ground_amsl_m:.1f} m AMSL)",
            round(height_m, 1),
            f"at least {MIN_START_HEIGHT_M:g} m",
        )
    )
    index = plan.trajectory.sequence[0]
    station = plan.mission.stations[index]
    limit = station.range_m - plan.mission.options.range_margin_m
    # A ball is convex: with the ground, the point above it and the start inside, the whole way is.
    above = np.array([here[0], here[1], max(float(start[2]), here[2])])
    ways = plan.ground.true_range_m(np.array([index] * 3), np.array([here, above, start]))
    checks.append(
        Check(
            "first station",
            Level.PASS if float(ways.max()) <= limit else Level.FAILURE,
            f"{station.id} is at most {float(ways.max()):.0f} m away during take-off and transit",
            round(float(ways.max()), 1),
            f"at most {limit:.0f} m (its range less the margin)",
        )
    )
    return checks


def judge_way_home(plan: Plan) -> Check:
    """Whether the autopilot's own return, straight home, stays in anybody's range (a warning where it does not)."""
    outside_s = sum(c.to_s - c.from_s for c in plan.contingencies if not c.straight_home_covered)
    share = outside_s / plan.mission_time_s
    message = "the autopilot's own return, straight home, " + (
        "stays in range throughout" if share == 0.0 else f"leaves every range when begun in {share:.0%} of the flight"
    )
    level = Level.PASS if share == 0.0 else Level.WARNING
    return Check("way home", level, message, round(share, 3), "known to the crew")


def judge_vehicle(
    *, armed: bool, landed_state: int, battery_percent: int | None, simulator_speedup: float | None, speedup: float
) -> list[Check]:
    """Findings about the vehicle itself: disarmed, on the ground, charged, and the simulator asked for."""
    on_ground = landed_state in (0, 1)
    checks = [
        Check(
            "disarmed",
            Level.FAILURE if armed or not on_ground else Level.PASS,
            "the vehicle is armed or in the air already" if armed or not on_ground else "disarmed, on the ground",
            {"armed": armed, "landed_state": landed_state},
            "disarmed and on the ground",
        )
    ]
    if battery_percent is not None:
        low = battery_percent < BATTERY_LOW_PERCENT
        checks.append(
            Check(
                "battery",
                Level.WARNING if low else Level.PASS,
                f"{battery_percent} % left",
                battery_percent,
                f"{BATTERY_LOW_PERCENT} % or more",
            )
        )
    if speedup != 1.0 or simulator_speedup is not None:
        fits = math.isclose(1.0 if simulator_speedup is None else simulator_speedup, speedup, rel_tol=1e-3)
        said = "it is no simulator" if simulator_speedup is None else f"it simulates at {simulator_speedup:g}"
        checks.append(
            Check(
                "speedup",
                Level.PASS if fits else Level.FAILURE,
                f"the flight's clock runs {speedup:g} times as fast; {said}",
                simulator_speedup,
                f"our simulator at a speed-up of {speedup:g}" if speedup != 1.0 else "a speed-up of 1 on both sides",
            )
        )
    return checks
