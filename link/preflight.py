"""What must hold before anything is armed: the vehicle, its place, its links, its limits against the plan.

Its failsafe parameters are judged in `link.failsafes`, its fence in `link.fence`. Every finding says what was found,
what is required and what to do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gcs.own_return import OwnReturn, Place, ReturnRules
from gcs.plan import Plan
from link.checks import Check, Level
from link.failsafes import Values, judge_failsafes, judge_rally_limit
from link.parameters import Asking
from link.profiles import AutopilotProfile
from link.projection import EkfOrigin
from link.request import FlightRequest
from link.telemetry import LinkQuality

__all__ = [
    "Check",
    "Identity",
    "Level",
    "judge_clock",
    "judge_identity",
    "judge_link",
    "judge_origin",
    "judge_own_return",
    "judge_parameters",
    "judge_performance",
    "judge_place",
    "judge_plan",
    "judge_vehicle",
    "return_rules",
]

GRAVITY_M_S2 = 9.80665
MIN_START_HEIGHT_M = 3.0
"""The plan's start must be this far above the vehicle's ground: below it a take-off is no take-off."""
BATTERY_LOW_PERCENT = 30
CLOCK_TOLERANCE_S = 1.0
LOSS_TOLERATED = 0.3
"""Share of a link's probes lost, there or back, from which a person is told."""
LATE_SHARE = 0.5
"""Of the time one attempt at a handover may take: a longer round trip is told, one longer than all of it refused."""

OLDEST = {"px4": (1, 12), "ardupilot": (4, 3)}
"""Firmware that the profiles were made for."""
_ROTORCRAFT = frozenset({2, 3, 4, 13, 14, 15, 29, 35})
_VTOL = frozenset(range(19, 26))
_RELEASES = ((64, "dev"), (128, "alpha"), (192, "beta"), (255, "rc"))


def judge_parameters(
    profile: AutopilotProfile, values: Values, request: FlightRequest, asking: Asking | None = None
) -> list[Check]:
    """Findings about the failsafe parameters, for this flight; see `link.failsafes`."""
    checks = judge_failsafes(profile, values, request.rate_hz, asking)
    safe_points = request.rally and bool(request.flown_plan.mission.safe_points)
    return [*checks, *judge_rally_limit(values, request.flown_plan, wanted=safe_points)]


def judge_performance(profile: AutopilotProfile, values: Values, plan: Plan) -> list[Check]:
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
        fits = asked <= profile.parameter(key).measure(parameter) * 1.001
        message = f"the plan's top {what} is {asked:.2f} m/s" + ("" if fits else "; the vehicle would fall behind")
        checks.append(
            Check(
                parameter.name,
                Level.PASS if fits else level,
                message,
                parameter.value,
                f"at least {asked:.2f} m/s, or a slower plan",
                fix=f"raise {parameter.name}, or plan with lower limits",
            )
        )
    tilt = values.get("max_tilt")
    if tilt is not None:
        degrees = profile.parameter("max_tilt").measure(tilt)
        possible = GRAVITY_M_S2 * math.tan(math.radians(min(degrees, 80.0)))
        needed = plan.mission.limits.max_accel_m_s2
        level = Level.PASS if needed <= 0.8 * possible else Level.WARNING if needed <= possible else Level.FAILURE
        message = f"{degrees:.0f} degrees of lean give {possible:.1f} m/s^2, drag included; the plan asks {needed:g}"
        fix = f"raise {tilt.name}, or plan with a smaller max_accel_m_s2"
        checks.append(Check(tilt.name, level, message, tilt.value, f"room for {needed:g} m/s^2", fix=fix))
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
            fix="take the vehicle to the plan's start, or plan from where it is",
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
            fix="plan with a higher start, or check the vehicle's altitude",
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
            fix="take the vehicle nearer to the plan's start",
        )
    )
    return checks


def return_rules(
    profile: AutopilotProfile, values: Values, plan: Plan, home_enu_m: Place, points: tuple[tuple[str, Place], ...]
) -> ReturnRules:
    """What the vehicle does when it returns by itself, as it is set; ``points`` are the rally points it holds."""

    def measured(key: str) -> float | None:
        known = any(parameter.key == key for parameter in profile.parameters)
        return profile.measure(values, key) if known else None

    limits = plan.mission.limits
    height_m = measured("return_altitude")
    limit_km = measured("rally_limit") or 0.0
    elsewhere = bool(points) and (measured("return_type") in (1.0, 5.0) or measured("rally_home") == 0.0)
    speed_m_s = measured("return_speed") or measured("max_speed") or limits.max_speed_m_s
    return ReturnRules(
        home_enu_m=home_enu_m,
        points=points,
        climb_to_up_m=-math.inf if height_m is None else home_enu_m[2] + height_m,
        limit_m=None if limit_km <= 0.0 else 1000.0 * limit_km,
        home_counts=not elsewhere,
        speed_m_s=max(0.5, speed_m_s),
        climb_m_s=max(0.2, measured("max_climb") or 1.0),
        sink_m_s=max(0.2, measured("max_descent") or 1.0),
    )


def judge_own_return(plan: Plan, rules: ReturnRules, returns: tuple[OwnReturn, ...]) -> list[Check]:
    """Where the autopilot's own failsafe takes the vehicle: in range or not, how long, how high."""
    duration_s = plan.mission_time_s
    share = sum(way.to_s - way.from_s for way in returns if not way.covered) / duration_s
    longest = max(returns, key=lambda way: way.duration_s)
    places = list(dict.fromkeys(way.to or "home" for way in returns))
    begun = "" if share == 0.0 else f" when begun in {share:.0%} of the flight"
    told = "stays in range throughout" if share == 0.0 else f"leaves every range{begun}"
    checks = [
        Check(
            "own return",
            Level.PASS if share == 0.0 else Level.WARNING,
            f"the autopilot's own return, straight to {' or '.join(places)}, {told}; "
            f"it takes up to {longest.duration_s:.0f} s",
            {"share_outside": round(share, 3), "longest_s": round(longest.duration_s, 1), "places": places},
            "known to the crew",
            fix="add safe points in range along the path, or let the crew expect the silence",
        )
    ]
    limits = plan.mission.limits
    if limits.endurance_s is not None:
        late = max(returns, key=lambda way: way.to_s + way.duration_s)
        whole_s = late.to_s + late.duration_s
        fits = whole_s <= limits.endurance_s
        checks.append(
            Check(
                "own return endurance",
                Level.PASS if fits else Level.WARNING,
                f"a return begun at T+{late.to_s:.0f} s ends at T+{whole_s:.0f} s",
                round(whole_s, 1),
                f"at most {limits.endurance_s:g} s (endurance)",
                fix="add safe points near the end of the path",
            )
        )
    if math.isfinite(rules.climb_to_up_m):
        height_amsl_m = rules.climb_to_up_m + plan.plane.alt_amsl_m
        over = height_amsl_m > limits.max_alt_amsl_m
        checks.append(
            Check(
                "return altitude",
                Level.WARNING if over else Level.PASS,
                f"the autopilot's own return climbs to {height_amsl_m:.0f} m AMSL"
                + (f", above the mission's {limits.max_alt_amsl_m:g} m" if over else ""),
                round(height_amsl_m, 1),
                f"at most {limits.max_alt_amsl_m:g} m AMSL, where the airspace asks for it",
                fix="lower the vehicle's return altitude, or clear the airspace above",
            )
        )
    return checks


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
    oldest = ".".join(map(str, OLDEST[profile.name]))
    required = f"{profile.title} {oldest} or newer"
    if identity is None:
        message = f"{profile.title}; it does not tell its version"
        check = Check("vehicle", Level.WARNING, message, None, required, fix="look up its firmware before you fly")
    else:
        old = identity.version[:2] < OLDEST[profile.name]
        message = f"{profile.title} {identity.text}" + ("; older than what this was made for" if old else "")
        level = Level.WARNING if old else Level.PASS
        check = Check("vehicle", level, message, ".".join(map(str, identity.version)), required, fix="update it")
    if vehicle_type is None:
        return [check]
    fit = vehicle_type in (_ROTORCRAFT | _VTOL if profile.name == "px4" else _ROTORCRAFT)
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


def judge_clock(vehicle_unix_s: float | None, our_unix_s: float, *, simulated: bool) -> Check:
    """The vehicle's UTC (SYSTEM_TIME, from its satellites) against ours, by which schedules are told to people."""
    required = f"within {CLOCK_TOLERANCE_S:g} s"
    if vehicle_unix_s is None:
        return Check("clock", Level.PASS, "the vehicle tells no UTC to compare this machine's with", None, required)
    skew_s = our_unix_s - vehicle_unix_s
    if simulated:
        return Check("clock", Level.PASS, "a simulator keeps its own time", round(skew_s, 3), required)
    fits = abs(skew_s) <= CLOCK_TOLERANCE_S
    message = f"this machine's clock is {abs(skew_s):.2f} s {'ahead of' if skew_s > 0 else 'behind'} the vehicle's UTC"
    fix = "let this machine follow NTP; launch times and handover times in UTC are off by as much"
    return Check("clock", Level.PASS if fits else Level.WARNING, message, round(skew_s, 3), required, fix=fix)


def judge_link(
    station: str,
    url: str,
    *,
    works: bool,
    same_origin: bool,
    required: bool,
    quality: LinkQuality | None,
    attempt_s: float,
    signed: bool,
    loopback: bool,
) -> list[Check]:
    """A station's link: heard and answered, how good it is, and whether it is signed.

    ``required``: must work on the ground already. ``attempt_s``: how long one attempt at a handover may take.
    """
    name = f"link {station}"
    if not same_origin:
        fix = "wait until the estimator has settled, and check that one vehicle is behind every link"
        told = "another EKF origin is told over it"
        return [Check(name, Level.FAILURE, told, url, "the same EKF origin over every link", fix=fix)]
    security = "signed" if signed else "unsigned, on this machine" if loopback else "unsigned, as allowed"
    figures = ""
    level, fix = Level.PASS, ""
    if quality is not None:
        figures = (
            f", {quality.loss:.0%} lost, {1e3 * quality.round_trip_s:.0f} ms there and back, "
            f"{1e3 * quality.jitter_s:.0f} ms jitter"
        )
        if quality.round_trip_s >= attempt_s:
            level, fix = Level.FAILURE, f"no handover could be confirmed in {attempt_s:g} s: use a faster link"
        elif quality.round_trip_s > LATE_SHARE * attempt_s or quality.loss > LOSS_TOLERATED:
            level, fix = Level.WARNING, "look for interference, a busy network or a weak antenna"
    if not works:
        level = Level.FAILURE if required else Level.WARNING
        fix = f"check that link: is {url} right, and the vehicle in its range?"
    elif level is Level.PASS and not (signed or loopback):
        level, fix = Level.WARNING, "sign it with --signing-key, or keep it inside a private network"
    message = (
        f"the vehicle is heard and answers over it{figures}; {security}"
        if works
        else "the vehicle is not heard over it (yet: it may be out of range)"
    )
    return [Check(name, level, message, url, "heard and answered, in time", fix=fix)]


def judge_origin(origin: EkfOrigin | None) -> Check:
    """The EKF origin, from which the vehicle counts."""
    if origin is None:
        fix = "wait for satellites; check its receiver"
        return Check("EKF origin", Level.ERROR, "the vehicle has none yet", None, "told by the vehicle", fix=fix)
    text = f"{origin.lat_deg:.7f}, {origin.lon_deg:.7f}, {origin.alt_amsl_m:.1f} m AMSL"
    return Check("EKF origin", Level.PASS, text, text, "told by the vehicle")


def judge_plan(plan: Plan, stations: tuple[str, ...], *, words: bool) -> Check:
    """The one plan every station of the flight has."""
    how = "each operator's word names it" if words else "one streamer serves them all"
    message = f"{plan.plan_sha256[:12]} for {', '.join(stations)}: {how}"
    return Check("plan", Level.PASS, message, plan.plan_sha256, "the same plan at every station")


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
            fix="land and disarm it",
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
                fix="charge or change it",
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
                fix="give `fly` and `simulate` the same --speedup",
            )
        )
    return checks
