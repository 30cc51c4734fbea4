"""The corridor: which station's ball every piece of the curve must lie in, and how long it must last.

With the paper's problem a corridor is one ball per piece (paper equation (17)). Overlap and tenure add
pieces that lie in two balls and last a least time:

      station A                 station B                 station C
    [ A ][ A ][A∩B] handover [A∩B][ B ][ B ][B∩C] handover [B∩C][ C ]
               └ half the overlap ┘           └ half the overlap ┘

so that a vehicle inside its pieces is covered by both stations for the whole overlap. A hovering vehicle can
stay in an overlap as long as it likes, so a corridor whose overlaps are not empty always has a trajectory.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from planner.errors import ProblemError
from planner.problem import Problem


@dataclass(frozen=True)
class Piece:
    """One Bézier piece: ``station`` (index into the problem) is in control; all of ``balls`` must hold it.

    ``leg`` counts the stations of the sequence from 0. ``min_duration_s`` is zero where nothing asks for more.
    """

    station: int
    leg: int
    balls: tuple[int, ...]
    min_duration_s: float = 0.0


@dataclass(frozen=True)
class Corridor:
    """Pieces in flight order. ``min_leg_s`` is the least sum of durations over the pieces of each leg."""

    sequence: tuple[int, ...]
    pieces: tuple[Piece, ...]
    min_leg_s: float

    def __len__(self) -> int:
        return len(self.pieces)

    def joint_balls(self, joint: int) -> tuple[int, ...]:
        """Balls that hold joint ``joint`` (1 .. len - 1, between pieces joint - 1 and joint), without repeats."""
        both = self.pieces[joint - 1].balls + self.pieces[joint].balls
        return tuple(dict.fromkeys(both))

    def leg_pieces(self, leg: int) -> list[int]:
        """Indices of the pieces of one leg."""
        return [k for k, piece in enumerate(self.pieces) if piece.leg == leg]


def build_corridor(
    problem: Problem,
    sequence: Sequence[int],
    *,
    pieces_per_leg: int = 1,
    pieces_at_ends: int | None = None,
    after_s: Sequence[float] = (),
) -> Corridor:
    """A corridor along ``sequence``: ``pieces_per_leg`` own pieces a station, ``pieces_at_ends`` in first and last leg.

    With an overlap, an entry and an exit piece that lie in both balls are added around each handover, and the
    leg's own pieces go between them. ``after_s`` is how long the station handed over from must go on covering the
    vehicle, a number for each handover, where that is more than half the overlap. A single station needs no tenure.

    Raises `ProblemError` for an empty sequence and for legs without a piece of their own: entry and exit pieces
    alone would ask three stations to meet in a point.
    """
    if not sequence or pieces_per_leg < 1 or (pieces_at_ends is not None and pieces_at_ends < 1):
        raise ProblemError("a corridor needs a station, and a piece of its own for every leg")
    legs = len(sequence)
    half = 0.5 * problem.min_overlap_s
    pieces: list[Piece] = []
    for leg, station in enumerate(sequence):
        is_end = leg in (0, legs - 1)
        own = pieces_at_ends if is_end and pieces_at_ends is not None else pieces_per_leg
        after = max(half, after_s[leg - 1]) if leg > 0 and after_s else half
        if leg > 0 and after > 0:
            pieces.append(Piece(station, leg, (station, sequence[leg - 1]), after))
        pieces.extend(Piece(station, leg, (station,)) for _ in range(own))
        if leg < legs - 1 and half > 0:
            pieces.append(Piece(station, leg, (station, sequence[leg + 1]), half))
    return Corridor(tuple(sequence), tuple(pieces), problem.min_tenure_s if legs > 1 else 0.0)
