"""A plan in a few lines a person reads."""

from __future__ import annotations

from gcs.exports.handovers import clock
from gcs.plan.model import TOGETHER, OptionCost, Plan

# Limits a certificate may speak of, with what to call them and their unit.
_NAMES = {
    "range_m": ("range", "m"),
    "altitude_m": ("altitude band", "m"),
    "speed_m_s": ("speed", "m/s"),
    "accel_m_s2": ("acceleration", "m/s2"),
    "jerk_m_s3": ("jerk", "m/s3"),
    "climb_m_s": ("climb rate", "m/s"),
    "descent_m_s": ("descent rate", "m/s"),
    "airspeed_m_s": ("airspeed", "m/s"),
    "overlap_s": ("handover overlap", "s"),
    "tenure_s": ("time in control", "s"),
    "duration_s": ("endurance", "s"),
}


def summary(plan: Plan) -> str:
    """Time against the bound, way, stations, what is left of every limit, how it was made, notes."""
    mission, bound = plan.mission, plan.lower_bound_s
    over = 100.0 * (plan.mission_time_s / bound - 1.0) if bound > 0 else 0.0
    against = f"{over:.1f} % over {bound:.1f} s, which no flight can beat"
    if bound <= 0:
        against = "start and destination are one place: there is no way to fly"
    options = mission.options
    lines = [
        mission.name,
        f"  mission time  {clock(plan.mission_time_s)} ({plan.mission_time_s:.1f} s), {against}",
        f"  way           {plan.path_length_m / 1000.0:.2f} km",
        f"  stations      {' > '.join(plan.station_ids)}  ({len(plan.handovers)} handovers)",
    ]
    if plan.fastest is not None:
        fewer, later_s = plan.fastest.handovers - len(plan.handovers), plan.fastest.fewer_cost_s
        cost = f"for {later_s:.1f} s more" if later_s >= 0.05 else "for nothing"
        lines.append(f"  handovers     {fewer} fewer than in the fastest plan found, {cost}")
    if plan.handovers:
        shortest = min(plan.handovers, key=lambda h: h.overlap_end_s - h.overlap_start_s)
        least = min(plan.handovers, key=lambda h: min(h.margin_from_m, h.margin_to_m))
        lines += [
            f"  overlap       at least {shortest.overlap_end_s - shortest.overlap_start_s:.1f} s "
            f"(handover {shortest.index}, {shortest.from_station} to {shortest.to_station})",
            f"  range left    at handovers at least {min(least.margin_from_m, least.margin_to_m):.1f} m "
            f"(handover {least.index}, {least.from_station} to {least.to_station})",
        ]
    left = [
        f"{name} {_left(plan, key)} {unit}" for key, (name, unit) in _NAMES.items() if key in plan.certificate.worst
    ]
    lines += [
        f"  limits left   {', '.join(left)}" if plan.certificate.feasible else "  NOT PROVEN: a limit is broken",
        f"  asked for     overlap {options.min_overlap_s:g} s, range margin {options.range_margin_m:g} m, "
        f"time in control {options.min_tenure_s:g} s, "
        f"{'fewest handovers' if options.handover_tolerance else 'least time'}",
        f"  planned       in {plan.solve_time_s:.2f} s by {plan.method}",
        f"  plan          {plan.plan_sha256}",
    ]
    lines += [f"  note          {note}" for note in plan.notes]
    if plan.costs:
        lines += ["", *cost_table(plan)]
    return "\n".join(lines) + "\n"


def cost_table(plan: Plan) -> list[str]:
    """Lines that say what every option costs, the dearest first and all of them together last."""
    single = sorted((c for c in plan.costs if c.option != TOGETHER), key=lambda c: -(c.cost_s or 0.0))
    rows = [(c.option, c.value, _seconds(c)) for c in (*single, *(c for c in plan.costs if c.option == TOGETHER))]
    widths = [max(len(row[k]) for row in rows) for k in range(3)]
    head = "  what the options cost: seconds the flight would be faster by without each"
    return [
        head,
        *(f"    {name:<{widths[0]}}  {value:<{widths[1]}}  {cost:>{widths[2]}}" for name, value, cost in rows),
    ]


def _seconds(cost: OptionCost) -> str:
    if cost.cost_s is None:
        return "not known"
    return f"{cost.cost_s:+.1f} s" if abs(cost.cost_s) >= 0.05 else "0.0 s"


def _left(plan: Plan, key: str) -> str:
    return f"{max(0.0, -plan.certificate.worst[key]):.3g}"
