"""Everything a vehicle's autopilot can say, said wrong: every message kind of the dialect, every field at its edges."""

from __future__ import annotations

import math
import random
from typing import Any

from link.dialect import mavlink
from tests.support.flights.tampered import TamperedFlight

INTEGERS = {
    "uint8_t": (0, 2**8 - 1),
    "int8_t": (-(2**7), 2**7 - 1),
    "uint16_t": (0, 2**16 - 1),
    "int16_t": (-(2**15), 2**15 - 1),
    "uint32_t": (0, 2**32 - 1),
    "int32_t": (-(2**31), 2**31 - 1),
    "uint64_t": (0, 2**64 - 1),
    "int64_t": (-(2**63), 2**63 - 1),
}
REALS = (0.0, -0.0, 1.0, -1.0, 1e-30, 1e30, 3.4e38, math.nan, math.inf, -math.inf)
OWN = {256}
"""SETUP_SIGNING, which never comes from a vehicle."""
KINDS = tuple(sorted(set(mavlink.mavlink_map) - OWN))
HEEDED = (0, 1, 2, 22, 24, 30, 32, 33, 44, 47, 49, 51, 73, 77, 85, 111, 132, 148, 193, 230, 242, 245, 253, 512)
"""Kinds the flight listens to, said more often than the others."""


def value(draw: random.Random, kind: str, truth: Any = None) -> Any:
    """A value for a field, often at an edge, sometimes near the true one."""
    if kind in ("float", "double"):
        return draw.choice(REALS)
    low, high = INTEGERS[kind]
    if isinstance(truth, int) and draw.random() < 0.3:
        return min(high, max(low, truth + draw.choice((-600_000, -4000, -1, 0, 1, 4000, 600_000))))
    return draw.choice((low, high, 0, 1, high // 2, draw.randint(low, high)))


def message(draw: random.Random, message_id: int, clock_ms: int) -> Any:
    """A message of a kind with every field drawn; stamps are the vehicle's own clock, or another."""
    kind = mavlink.mavlink_map[message_id]
    values = []
    for name in kind.fieldnames:
        place = kind.ordered_fieldnames.index(name)
        length, form = kind.array_lengths[place], kind.fieldtypes[kind.fieldnames.index(name)]
        if form == "char":
            values.append(bytes(draw.randrange(256) for _ in range(draw.randint(0, max(1, length)))))
        elif length:
            values.append([value(draw, form) for _ in range(length)])
        elif name == "time_boot_ms" and draw.random() < 0.6:
            values.append(clock_ms)
        else:
            values.append(value(draw, form, clock_ms))
    return kind(*values)


def harass(flight: TamperedFlight, seed: int, seconds: float, every_s: float = 0.05) -> int:
    """Say such messages beside the true ones for so long; how many were said."""
    draw, said, end_s = random.Random(seed), 0, flight.now_s + seconds
    while flight.now_s < end_s and not flight.core.finished:
        message_id = draw.choice(HEEDED) if draw.random() < 0.5 else draw.choice(KINDS)
        one = message(draw, message_id, int(flight.vehicle.time_s * 1e3) & 0xFFFFFFFF)
        for _ in range(draw.choice((1, 1, 1, 3))):
            flight.say(one, links=draw.sample(flight.links, draw.randint(1, len(flight.links))))
            said += 1
        flight.run_for(every_s)
    return said
