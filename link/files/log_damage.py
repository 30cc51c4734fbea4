"""What is wrong with a log, counted and told: damaged bytes, holes, repetitions, clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

ROLLOVER_S = 1024 * 7 * 86400.0
"""The week number of GPS has ten bits."""
UTC_WITHIN_S = 2.0


@dataclass(frozen=True)
class LogDamage:
    """Counts over the whole log. Times are the log's, set right (Unix seconds).

    ``damaged_places`` are stretches that are no record (frames cut or overwritten), of ``skipped_bytes`` of the log's
    ``total_bytes``, ``cut_tail_bytes`` of them at its end. ``missing_frames``: frames of the stations whose numbers are
    left out, at least (their numbers come round after 256). ``holes``: (from, to) of stretches that something is
    missing from. ``repeated_records`` were left out. ``unknown_frames``: of kinds not in our dialect, or damaged.
    ``clock_steps``: (when, by how many seconds) of the ground's clock; ``stray_stamps`` single times out of line.
    ``utc_off_s``: the log's UTC less the vehicle's, None where it told none. ``ends_armed``: the log ends with the
    vehicle armed.
    """

    total_bytes: int = 0
    damaged_places: int = 0
    skipped_bytes: int = 0
    cut_tail_bytes: int = 0
    missing_frames: int = 0
    holes: tuple[tuple[float, float], ...] = ()
    repeated_records: int = 0
    unknown_frames: int = 0
    clock_steps: tuple[tuple[float, float], ...] = ()
    stray_stamps: int = 0
    utc_off_s: float | None = None
    ends_armed: bool = False

    @property
    def lines(self) -> tuple[str, ...]:
        """A line for each finding, for people; none where nothing is wrong."""
        told = []
        if self.skipped_bytes:
            tail = f", {self.cut_tail_bytes} of them at its end, which is cut" if self.cut_tail_bytes else ""
            places = f" in {self.damaged_places} place{'s' if self.damaged_places != 1 else ''}"
            told.append(f"{self.skipped_bytes} of {self.total_bytes} bytes are damaged{places}, and left out{tail}")
        if self.missing_frames:
            told.append(f"at least {self.missing_frames} frames of the stations are missing, by their numbers")
        if self.holes:
            longest = max(to_s - from_s for from_s, to_s in self.holes)
            holes = "1 hole" if len(self.holes) == 1 else f"{len(self.holes)} holes"
            told.append(f"{holes}, the longest of {longest:.2f} s: what happened there is not known")
        if self.repeated_records:
            told.append(f"{self.repeated_records} records stand there twice, and count once")
        if self.unknown_frames:
            told.append(f"{self.unknown_frames} frames are of unknown kinds (another dialect's, or damaged)")
        for _, by_s in self.clock_steps:
            told.append(f"the ground's clock was stepped by {by_s:+.1f} s: judged on the vehicle's clock")
        if self.stray_stamps:
            told.append(f"{self.stray_stamps} times are out of line with those before and after")
        if self.ends_armed:
            told.append("it ends while the vehicle is armed: the flight's end is not in it")
        return tuple(told)

    @property
    def clock_lines(self) -> list[str]:
        """The vehicle's UTC against the log's, where they differ: no damage, and no figure here hangs on it."""
        off_s = self.utc_off_s
        if off_s is None or abs(off_s) <= UTC_WITHIN_S:
            return []
        rounds = round(off_s / ROLLOVER_S)
        if rounds and abs(off_s - rounds * ROLLOVER_S) <= 86400.0:
            weeks = f"{abs(rounds) * 1024} weeks {'behind' if rounds > 0 else 'ahead'}"
            return [f"the vehicle's date is {weeks}: GPS week rollover in its receiver, not this machine's clock"]
        side = "ahead of" if off_s > 0 else "behind"
        return [
            f"the ground's clock is {abs(off_s):.1f} s {side} the vehicle's UTC: times of day may be off by as much"
        ]

    def hides(self, from_s: float, to_s: float) -> bool:
        """Whether something is missing between two times."""
        return any(from_s < high + 1e-9 and low < to_s + 1e-9 for low, high in self.holes)

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        document = {name: getattr(self, name) for name in self.__dataclass_fields__}
        document["holes"] = [list(hole) for hole in self.holes]
        document["clock_steps"] = [list(step) for step in self.clock_steps]
        return {**document, "told": [*self.lines, *self.clock_lines]}
