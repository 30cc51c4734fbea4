"""Rates of the wire layer on this machine: encode, pack, sign, parse, resample; beside a reference of the same run.

A figure of one machine says little, so each comes as calls per second and as a ratio to a plain piece of work (SHA-256
of 64 bytes) timed in the same run.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from link.autopilot import PROFILES, EkfOrigin
from link.dialect import mavlink
from link.setpoints import SetpointSampler
from link.wire import Signing, SigningKey, SigningStore, StationCodec

if TYPE_CHECKING:
    from gcs.plan import Plan

_BATCH_S = 5e-4


@dataclass(frozen=True)
class Rate:
    """How often something can be done on one core. ``per_reference`` is its cost in units of the reference's."""

    name: str
    per_second: float
    per_reference: float


def _per_second(work: Callable[[], Any], seconds: float) -> float:
    """Best batch of those that fit into ``seconds``; short batches, so that on a busy machine some run undisturbed."""
    best = float("inf")
    count = 1
    end = time.perf_counter() + seconds
    while True:
        begin = time.perf_counter()
        for _ in range(count):
            work()
        now = time.perf_counter()
        best = min(best, (now - begin) / count)
        if now >= end:
            return 1.0 / best
        count = max(1, int(_BATCH_S / best))


def wire_rates(plan: Plan, *, rate_hz: float = 50.0, seconds: float = 0.3) -> list[Rate]:
    """Every rate, the reference first; takes about ``seconds`` for each of nine."""
    stream = SetpointSampler(plan, rate_hz)
    middle_s = 0.5 * stream.duration_s
    setpoint = stream.at(middle_s)
    plane = plan.plane
    origin = EkfOrigin(plane.lat_deg, plane.lon_deg, plane.alt_amsl_m)
    messages = {name: profile.encode(setpoint, target_system=1, origin=origin) for name, profile in PROFILES.items()}
    plain, vehicle = StationCodec(241), StationCodec(1, 1)
    key = SigningKey.from_passphrase("benchmark")
    signed = StationCodec(241, signing=Signing(key, 241, SigningStore.in_memory()))
    attitude = vehicle.encode(mavlink.MAVLink_attitude_message(1, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0))
    reader = StationCodec(241)
    sender = StationCodec(1, 1, signing=Signing(key, 1, SigningStore.in_memory()))
    # A signed frame is taken once: as many different ones as there are readings.
    verifier = StationCodec(241, signing=Signing(key, 241, SigningStore.in_memory()))
    payload = bytes(64)

    def encode(name: str) -> Callable[[], Any]:
        profile = PROFILES[name]
        return lambda: profile.encode(setpoint, target_system=1, origin=origin)

    works: dict[str, Callable[[], Any]] = {
        "reference: SHA-256 of 64 bytes": lambda: hashlib.sha256(payload).digest(),
        "setpoint at any time": lambda: stream.at(middle_s),
        "encode for PX4": encode("px4"),
        "encode for ArduPilot": encode("ardupilot"),
        "pack": lambda: plain.encode(messages["px4"]),
        "pack and sign": lambda: signed.encode(messages["px4"]),
        "parse": lambda: reader.decode(attitude),
        "sign, parse and verify": lambda: verifier.decode(sender.encode(messages["px4"])),
    }
    found: list[Rate] = []
    reference = 0.0
    for name, work in works.items():
        work()
        per_second = _per_second(work, seconds)
        reference = reference or per_second
        found.append(Rate(name, per_second, reference / per_second))
    begin = time.perf_counter()
    samples = sum(len(block) for block in stream.blocks())
    resampled = samples / (time.perf_counter() - begin)
    found.append(Rate("resample (whole stream)", resampled, reference / resampled))
    return found
