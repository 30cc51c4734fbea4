"""Whether the C2 links carry the flight's stream, judged before the flight."""

from __future__ import annotations

from link.preflight.check import Check, Level
from link.telemetry.link_path import LinkQuality

LOSS_TOLERATED = 0.3
"""Share of a C2 link's probes lost, there or back, from which a person is told."""
LATE_SHARE = 0.5
"""Of the time one attempt at a handover may take: a longer round trip is told, one longer than all of it refused."""


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
    """A station's C2 link: heard and answered, how good it is, and whether it is signed.

    ``required``: must work on the ground already. ``attempt_s``: how long one attempt at a handover may take.
    """
    name = f"link {station}"
    if not same_origin:
        fix = "wait until the estimator has settled, and check that one vehicle is behind every C2 link"
        told = "another EKF origin is told over it"
        return [Check(name, Level.FAILURE, told, url, "the same EKF origin over every C2 link", fix=fix)]
    security = "signed" if signed else "unsigned, on this machine" if loopback else "unsigned, as allowed"
    figures = ""
    level, fix = Level.PASS, ""
    if quality is not None:
        figures = (
            f", {quality.loss:.0%} lost, {1e3 * quality.round_trip_s:.0f} ms there and back, "
            f"{1e3 * quality.jitter_s:.0f} ms jitter"
        )
        if quality.round_trip_s >= attempt_s:
            level, fix = Level.FAILURE, f"no handover could be confirmed in {attempt_s:g} s: use a faster C2 link"
        elif quality.round_trip_s > LATE_SHARE * attempt_s or quality.loss > LOSS_TOLERATED:
            level, fix = Level.WARNING, "look for interference, a busy network or a weak antenna"
    if not works:
        level = Level.FAILURE if required else Level.WARNING
        fix = f"check that C2 link: is {url} right, and the vehicle in its range?"
    elif level is Level.PASS and not (signed or loopback):
        level, fix = Level.WARNING, "sign it with --signing-key, or keep it inside a private network"
    message = (
        f"C2 link nominal: the vehicle is heard and answers over it{figures}; {security}"
        if works
        else "no C2 link: the vehicle is not heard over it (yet: it may be out of range)"
    )
    return [Check(name, level, message, url, "heard and answered, in time", fix=fix)]
