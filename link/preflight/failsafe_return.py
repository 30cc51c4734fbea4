"""The failsafe return: where the autopilot would take the vehicle by itself, judged before the flight."""

from __future__ import annotations

import math

from gcs.plan import FailsafeReturn, Place, Plan, ReturnRules
from link.autopilot.parameter_catalogue import Values
from link.autopilot.profile import AutopilotProfile
from link.preflight.check import Check, Level


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


def judge_failsafe_return(plan: Plan, rules: ReturnRules, returns: tuple[FailsafeReturn, ...]) -> list[Check]:
    """Where the autopilot's own failsafe takes the vehicle: in range or not, how long, how high."""
    duration_s = plan.mission_time_s
    share = sum(span.to_s - span.from_s for span in returns if not span.covered) / duration_s
    longest = max(returns, key=lambda span: span.duration_s)
    places = list(dict.fromkeys(span.to or "home" for span in returns))
    begun = "" if share == 0.0 else f" when begun in {share:.0%} of the flight"
    told = "stays in range throughout" if share == 0.0 else f"leaves every range{begun}"
    checks = [
        Check(
            "failsafe return",
            Level.PASS if share == 0.0 else Level.WARNING,
            f"the autopilot's failsafe return, straight to {' or '.join(places)}, {told}; "
            f"it takes up to {longest.duration_s:.0f} s",
            {"share_outside": round(share, 3), "longest_s": round(longest.duration_s, 1), "places": places},
            "known to the crew",
            fix="add safe points in range along the path, or let the crew expect a lost C2 link",
        )
    ]
    limits = plan.mission.limits
    if limits.endurance_s is not None:
        late = max(returns, key=lambda span: span.to_s + span.duration_s)
        whole_s = late.to_s + late.duration_s
        fits = whole_s <= limits.endurance_s
        checks.append(
            Check(
                "failsafe return endurance",
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
                f"the autopilot's failsafe return climbs to {height_amsl_m:.0f} m AMSL"
                + (f", above the mission's {limits.max_alt_amsl_m:g} m" if over else ""),
                round(height_amsl_m, 1),
                f"at most {limits.max_alt_amsl_m:g} m AMSL, where the airspace asks for it",
                fix="lower the vehicle's return altitude, or clear the airspace above",
            )
        )
    return checks
