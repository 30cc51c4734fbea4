"""What the crew should know of the plan's path before take-off: the ground below, and where a stop comes too late."""

from __future__ import annotations

import math

import numpy as np

from gcs.plan import Plan
from link.handover.handover_chain import TAKEOVER_SHARE
from link.preflight.check import Check, Level
from link.setpoints.reference import ReferenceTrajectory
from link.setpoints.sampler import SetpointSampler

HANDED_OVER_S = 0.3
"""Until the handover is confirmed, and until the transferring station has taken over again: answers there and back."""
_SAMPLE_S = 0.2
_STEP_S, _BEHIND_S = 0.05, 1.0


def judge_lowest(plan: Plan, ground_amsl_m: float) -> Check:
    """The plan's lowest altitude against the only ground known: ``ground_amsl_m``, on which the vehicle stands."""
    count = max(2, math.ceil(plan.trajectory.duration_s / _SAMPLE_S) + 1)
    times = np.linspace(0.0, plan.trajectory.duration_s, count)
    heights = plan.trajectory.evaluate(times)[:, 2] + plan.plane.alt_amsl_m
    lowest_m, at_s = float(heights.min()), float(times[int(heights.argmin())])
    below_m = ground_amsl_m - lowest_m
    message = (
        f"the plan goes down to {lowest_m:.1f} m AMSL, at T+{at_s:.0f} s; the vehicle stands at {ground_amsl_m:.1f} m"
    )
    if below_m > 0.0:
        message += f": {below_m:.1f} m higher. What ground lies under the path is not known here"
    return Check(
        "lowest altitude",
        Level.WARNING if below_m > 0.0 else Level.PASS,
        message,
        round(lowest_m, 1),
        "above the ground under the path",
        fix="compare the path with a map of the terrain; plan with a higher min_alt_amsl_m where it is too low",
    )


def judge_stops(plan: Plan, loss_timeout_s: float, *, after_s: float = 0.0) -> list[Check]:
    """Whether the flight can still stop in the transferring station's range when the receiving one fails at once.

    Such a failure is noticed after `link.handover.handover_chain.TAKEOVER_SHARE` of ``loss_timeout_s`` (the
    autopilot's); the transferring station then takes over again, and the flight brakes as hard as the plan allows
    (`link.setpoints.reference.ReferenceTrajectory`). One check a handover for which that is too late, or one that
    passes.
    ``after_s``: handovers later in the plan than this alone.
    """
    reference = ReferenceTrajectory(SetpointSampler(plan), accel_m_s2=plan.mission.limits.max_accel_m_s2)
    checks, spare_s = [], math.inf
    handovers = [handover for handover in plan.handovers if handover.time_s > after_s]
    for handover in handovers:
        noticed_s = handover.time_s + HANDED_OVER_S + TAKEOVER_SHARE * loss_timeout_s
        stop_s = _full_stop_s(reference.placed(min(noticed_s, plan.mission_time_s), 1.0))
        left_s, needed_s = handover.overlap_end_s - handover.time_s, stop_s - handover.time_s
        spare_s = min(spare_s, left_s - needed_s)
        if needed_s <= left_s:
            continue
        transferring = np.array([plan.mission.station_index(handover.from_station)])
        beyond = plan.trajectory.evaluate(np.linspace(handover.time_s, stop_s, 100))
        outside_m = max(0.0, float(plan.geometry.outside_m(np.repeat(transferring, 100), beyond).max()))
        speed_m_s = reference.speed_m_s(handover.time_s)
        checks.append(
            Check(
                f"handover {handover.index}",
                Level.WARNING,
                f"the path leaves the range of the transferring station {handover.from_station} {left_s:.1f} s after "
                f"it; to notice a failure of the receiving station {handover.to_station} and to stop from "
                f"{speed_m_s:.0f} m/s takes {needed_s:.1f} s of the path: should it fail right then, the vehicle gets "
                f"{outside_m:.0f} m out of range",
                round(left_s, 2),
                f"at least {needed_s:.1f} s",
                fix=f"plan with min_overlap_s {math.ceil(2.0 * needed_s)}, half of it after the handover, or slower",
            )
        )
    if handovers and not checks:
        message = (
            f"after each the flight can still stop in the transferring station's range, with {spare_s:.1f} s to spare"
        )
        checks.append(Check("handovers", Level.PASS, message, round(spare_s, 2), "room to stop"))
    return checks


def _full_stop_s(reference: ReferenceTrajectory) -> float:
    """The time of the plan at which a reference comes to rest that brakes as hard as it may, from now on."""
    limit_s = max(1e-6, reference.time_s - _BEHIND_S)
    furthest_s = reference.time_s
    while reference.rate > 0.0 and not (reference.stands or reference.finished):
        # A limit that is behind already is braked for with all there is.
        reference.step(_STEP_S, 1.0, high_s=limit_s)
        furthest_s = max(furthest_s, reference.time_s)
    return furthest_s
