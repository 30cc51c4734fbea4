"""What must hold before anything is armed: the vehicle, its place, its links, its limits against the plan.

Its failsafe parameters are judged in `link.preflight.failsafe_parameters`, its fence in `link.preflight.geofence`.
Every finding says what was found, what is required and what to do.
"""

from __future__ import annotations

import math

import numpy as np

from gcs.plan import Plan
from link.autopilot.local_frame import EkfOrigin
from link.autopilot.parameter_catalogue import Values
from link.autopilot.profile import AutopilotProfile
from link.microservices.parameter import Asking
from link.preflight.check import Check, Level
from link.preflight.failsafe_parameters import judge_failsafes, judge_rally_limit
from link.session.request import FlightRequest
from link.telemetry.plausibility import HomePlace, Position, apart_m

GRAVITY_M_S2 = 9.80665
MIN_START_HEIGHT_M = 3.0
"""The plan's start must be this far above the vehicle's ground: below it a take-off is no take-off."""
BATTERY_LOW_PERCENT = 30
CLOCK_TOLERANCE_S = 1.0
GPS_ROLLOVER_S = 1024 * 7 * 86400.0
ROLLOVER_WITHIN_S = 86400.0
"""So near whole rounds of the GPS week number, a difference of clocks is one: no clock is years off by itself."""
HOME_NEAR_M = 50.0


def judge_parameters(
    profile: AutopilotProfile, values: Values, request: FlightRequest, asking: Asking | None = None
) -> list[Check]:
    """Findings about the failsafe parameters, for this flight; see `link.preflight.failsafe_parameters`."""
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
    for key, asked, what, level in (
        ("max_speed", speed, "horizontal speed", Level.FAILURE),
        ("max_climb", climb, "climb", Level.WARNING),
        ("max_descent", descent, "descent", Level.WARNING),
    ):
        parameter = values.get(key)
        if parameter is None or not profile.binding_speeds:
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
    # A ball is convex: with the ground, the point above it and the start inside, all between them is.
    above = np.array([here[0], here[1], max(float(start[2]), here[2])])
    ways = plan.geometry.true_range_m(np.array([index] * 3), np.array([here, above, start]))
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
    weeks = round(skew_s / GPS_ROLLOVER_S)
    if weeks and abs(skew_s - weeks * GPS_ROLLOVER_S) <= ROLLOVER_WITHIN_S:
        # The week number of GPS has ten bits: an old receiver tells a date whole rounds of it away.
        message = f"the vehicle's satellite receiver tells a date {abs(weeks) * 1024} weeks off (GPS week rollover)"
        fix = "update the receiver's firmware; this machine's clock needs nothing"
    return Check("clock", Level.PASS if fits else Level.WARNING, message, round(skew_s, 3), required, fix=fix)


def judge_origin(origin: EkfOrigin | None) -> Check:
    """The EKF origin, from which the vehicle counts."""
    if origin is None:
        fix = "wait for satellites; check its receiver"
        return Check("EKF origin", Level.ERROR, "the vehicle has none yet", None, "told by the vehicle", fix=fix)
    text = f"{origin.lat_deg:.7f}, {origin.lon_deg:.7f}, {origin.alt_amsl_m:.1f} m AMSL"
    return Check("EKF origin", Level.PASS, text, text, "told by the vehicle")


def judge_estimate(lacks: str) -> Check:
    """Whether its receiver and estimator know where it is: it would not arm, or not fly straight, without."""
    level = Level.FAILURE if lacks else Level.PASS
    fix = "wait for satellites, with a free view of the sky; look at its receiver and its own words"
    return Check("position estimate", level, lacks or "nothing it reports is against it", None, "good", fix=fix)


def judge_home(home: HomePlace | None, here: Position | None) -> Check:
    """Where the autopilot's own return leads: its home, which is to be where the vehicle stands."""
    required = f"within {HOME_NEAR_M:g} m of the vehicle"
    if home is None or here is None:
        fix = "let the crew look at home in another ground station: its own return leads there"
        return Check("home", Level.WARNING, "the vehicle does not tell its home", None, required, fix=fix)
    away_m = apart_m(home.lat_deg, home.lon_deg, here.lat_deg, here.lon_deg)
    fits = away_m <= HOME_NEAR_M
    message = f"home is {away_m:.0f} m from the vehicle"
    fix = "set home where the vehicle stands (MAV_CMD_DO_SET_HOME): its own return leads there"
    return Check("home", Level.PASS if fits else Level.FAILURE, message, round(away_m, 1), required, fix=fix)


def judge_plan(plan: Plan, stations: tuple[str, ...], *, operator_commands: bool) -> Check:
    """The one plan every station of the flight has."""
    how = "each operator's command names it" if operator_commands else "one streamer serves them all"
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
    low = battery_percent is None or battery_percent < BATTERY_LOW_PERCENT
    checks.append(
        Check(
            "battery",
            Level.WARNING if low else Level.PASS,
            "it does not tell how much is left" if battery_percent is None else f"{battery_percent} % left",
            battery_percent,
            f"{BATTERY_LOW_PERCENT} % or more",
            fix="look at the battery itself" if battery_percent is None else "charge or change it",
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
