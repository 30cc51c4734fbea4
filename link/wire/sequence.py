"""Frames counted by their sequence numbers: one byte, that goes on by one with every frame of a sender over a link."""

from __future__ import annotations

NUMBERS = 256


def frames_ahead(before: int, now: int) -> int:
    """How many frames after the one numbered ``before`` the one numbered ``now`` left, -128 to 127; 0: the same number.

    One less is how many are missing between; zero or less came late or twice.
    """
    return (now - before + NUMBERS // 2) % NUMBERS - NUMBERS // 2
