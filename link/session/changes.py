"""What a flight has changed on a vehicle, as data: noted before it is changed, for whoever comes next to give back.

`VehicleChanges` is one flight's; a `ChangeJournal` keeps them (`link.files.change_journal`). A note says what each
thing was *before* and what the flight made of it: a value that is neither any more was changed by somebody else since,
and is left alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

from link.microservices.mission_item import TYPE_NAMES, MissionItem

Items = tuple[MissionItem, ...]


@dataclass(frozen=True)
class VehicleChanges:
    """One flight's changes. ``uid`` is the autopilot's own id (AUTOPILOT_VERSION; None: it tells none).

    ``gcs_ids``: GCS id parameters as they were, by name; the flight sets them to the ids of ``stations`` as it needs.
    ``settings``: (before, after) by name. ``lists``: (before, after) by MAV_MISSION_TYPE.
    """

    key: str
    flight_id: str
    autopilot: str
    system_id: int
    uid: str | None
    urls: tuple[str, ...]
    stations: tuple[int, ...]
    signing_key: str | None = None
    """``file:PATH`` or ``env:NAME``; never the key."""
    signing_state: str | None = None
    run_dir: str | None = None
    pid: int | None = None
    utc: str = ""
    gcs_ids: Mapping[str, int] = field(default_factory=dict)
    settings: Mapping[str, tuple[int | float, int | float]] = field(default_factory=dict)
    lists: Mapping[int, tuple[Items, Items]] = field(default_factory=dict)

    @property
    def empty(self) -> bool:
        """Whether nothing is changed (any more)."""
        return not (self.gcs_ids or self.settings or self.lists)

    @property
    def texts(self) -> list[str]:
        """What is changed, for people: each thing, and what it was."""
        told = [f"{name} (was {value})" for name, value in self.gcs_ids.items()]
        told += [f"{name} (was {before:g})" for name, (before, _) in self.settings.items()]
        return told + [f"{TYPE_NAMES[kind]} (held {len(before)})" for kind, (before, _) in self.lists.items()]

    @property
    def remedy(self) -> str:
        """The command that gives it back."""
        return f"skyrelay vehicle restore --link {self.urls[0]}"

    def is_of(self, system_id: int, uid: str | None, urls: Iterable[str] | None = None) -> bool:
        """Whether it is of this vehicle: by its uid, else (one told none) by system id and, where given, a link."""
        if self.uid is not None and uid is not None:
            return self.uid == uid
        return self.system_id == system_id and (urls is None or bool(set(urls) & set(self.urls)))

    def without(
        self, *, gcs_ids: bool = False, settings: Iterable[str] = (), lists: Iterable[int] = ()
    ) -> VehicleChanges:
        """What is left when these have been given back."""
        gone_settings, gone_lists = set(settings), set(lists)
        return replace(
            self,
            gcs_ids={} if gcs_ids else self.gcs_ids,
            settings={k: v for k, v in self.settings.items() if k not in gone_settings},
            lists={k: v for k, v in self.lists.items() if k not in gone_lists},
        )

    def to_document(self) -> dict[str, Any]:
        """As a JSON object."""
        document = {f: getattr(self, f) for f in self.__dataclass_fields__ if f != "lists"}
        document["lists"] = {str(kind): [_written(items) for items in pair] for kind, pair in self.lists.items()}
        return {"version": 1, **document}

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> VehicleChanges:
        """From `to_document`. Raises ``ValueError``, ``KeyError``, ``TypeError`` or `MissionItemError` for another."""
        given = dict(document)
        if given.pop("version") != 1:
            raise ValueError(f"a note of version {document['version']}: 1 is known")
        given["urls"], given["stations"] = tuple(map(str, given["urls"])), tuple(map(int, given["stations"]))
        given["settings"] = {str(k): (b, a) for k, (b, a) in given["settings"].items()}
        given["gcs_ids"] = {str(k): int(v) for k, v in given["gcs_ids"].items()}
        given["lists"] = {int(k): (_read(b), _read(a)) for k, (b, a) in given["lists"].items()}
        return cls(**given)


def _written(items: Sequence[MissionItem]) -> list[dict[str, Any]]:
    documents = [asdict(item) for item in items]
    for one in documents:
        one["parameters"] = [None if math.isnan(p) else p for p in one["parameters"]]
    return documents


def _read(documents: Sequence[Mapping[str, Any]]) -> Items:
    items = []
    for one in documents:
        first, second, third, fourth = (math.nan if p is None else float(p) for p in one["parameters"])
        items.append(MissionItem(**{**one, "parameters": (first, second, third, fourth)}))
    return tuple(items)


def unique_id(version: Any) -> str | None:
    """The autopilot's own id out of its AUTOPILOT_VERSION: uid2, else uid; None where it tells none."""
    if version is None:
        return None
    uid2 = bytes(version.uid2)
    if any(uid2):
        return "uid2:" + uid2.hex()
    uid = int(version.uid)
    return f"uid:{uid:016x}" if uid else None


class ChangeJournal(Protocol):
    """Where changes are noted. What `keep` was given outlives the process when it returns."""

    def keep(self, changes: VehicleChanges) -> None:
        """Note what is about to be changed, or what of it is left. Raises ``OSError``: then nothing may be changed."""
        ...

    def done(self, key: str) -> None:
        """All of it has been given back. Never raises: a note too many does no harm."""
        ...

    def pending(self) -> list[VehicleChanges]:
        """What flights that have ended left changed, the oldest first; of flights that go on: see `in_use`."""
        ...

    def in_use(self, changes: VehicleChanges) -> bool:
        """Whether the flight that noted it still runs."""
        ...


class MemoryJournal:
    """A journal that lasts as long as its process: for a flight that has no folder to write to."""

    def __init__(self) -> None:
        self.notes: dict[str, VehicleChanges] = {}

    def keep(self, changes: VehicleChanges) -> None:
        """Note it."""
        self.notes[changes.key] = changes

    def done(self, key: str) -> None:
        """Forget it."""
        self.notes.pop(key, None)

    def pending(self) -> list[VehicleChanges]:
        """All that is noted."""
        return list(self.notes.values())

    def in_use(self, changes: VehicleChanges) -> bool:
        """Nobody else can have written here."""
        return False
