"""One flight's note in the journal of changes: kept before each change, struck when it is given back.

And what earlier flights of the vehicle left there, given back before anything is taken anew.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from link.handover.restoration import Microservices, restore_changes
from link.microservices.mission_client import MissionClient
from link.microservices.parameter import ParameterClient
from link.session.changes import ChangeJournal, MemoryJournal, VehicleChanges, unique_id
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps


class ChangeNote:
    """The note of one flight. ``changes`` is what it holds now."""

    def __init__(
        self,
        flight: FlightContext,
        parameters: ParameterClient,
        missions: MissionClient,
        journal: ChangeJournal | None = None,
    ) -> None:
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._services = Microservices(flight.timeline, flight.vehicle, flight.control, parameters, missions)
        self._journal: ChangeJournal = MemoryJournal() if journal is None else journal
        request = flight.request
        self.changes = VehicleChanges(
            key=f"{flight.vehicle.system_id}-{uuid.uuid4().hex[:16]}",
            flight_id=request.flight_id,
            autopilot=request.autopilot,
            system_id=flight.vehicle.system_id,
            uid=None,
            urls=tuple(dict.fromkeys(url for urls in request.urls.values() for url in urls)),
            stations=tuple(sorted(request.system_ids.values())),
            signing_key=request.signing_key,
            signing_state=request.signing_state,
        )

    @property
    def remedy(self) -> str:
        """The command that gives back what a flight of this vehicle left changed."""
        return self.changes.remedy

    def keep(self, **changed: Any) -> str:
        """Note what is about to be changed; why it must not be changed where that cannot be noted, else nothing."""
        changes = replace(self.changes, uid=unique_id(self._vehicle.monitor.version), **changed)
        try:
            self._journal.keep(changes)
        except OSError as error:
            return f"nothing was changed: the journal that gives it back cannot be written ({error})"
        self.changes = changes
        return ""

    def strike(self, settings: Sequence[str], lists: Sequence[int], *, owned: bool) -> None:
        """Leave what stays changed, and no more: these settings and lists, and with ``owned`` the GCS ids."""
        noted = self.changes
        left = replace(
            noted,
            settings={k: v for k, v in noted.settings.items() if k in settings},
            lists={k: v for k, v in noted.lists.items() if k in lists},
            gcs_ids=noted.gcs_ids if owned else {},
        )
        if left.empty:
            self._journal.done(noted.key)
            self.changes = left
        else:
            # Where that fails the older note stands, which names more than is left: read before it is written.
            self.keep(settings=left.settings, lists=left.lists, gcs_ids=left.gcs_ids)

    def left_by_others(self) -> list[VehicleChanges]:
        """What earlier flights of this vehicle left changed, those that have ended."""
        uid = unique_id(self._vehicle.monitor.version)
        return [
            one
            for one in self._journal.pending()
            if one.key != self.changes.key
            and one.is_of(self._vehicle.system_id, uid, self.changes.urls)
            and not self._journal.in_use(one)
        ]

    def recover(self) -> Steps[bool]:
        """Give back what earlier flights left changed; whether there was anything.

        Raises `Refused` where it stays, or the vehicle is armed.
        """
        found = self.left_by_others()
        for one in found:
            if self._vehicle.armed:
                raise Refused(f"flight {one.flight_id} left this vehicle changed, and it is armed: land it first")
            station = self._control.in_force.station_id
            self._timeline.alarm("an earlier flight left this changed", flight=one.flight_id, changed=one.texts)
            sure = bool(set(one.urls) & set(self.changes.urls))
            done = yield from restore_changes(self._services, self._journal, one, sure=sure)
            self._control.grant(station, "restoration over")
            if not done.complete:
                kept = ", ".join(done.failed)
                told = f"flight {one.flight_id} left {kept} changed, and it could not be given back"
                raise Refused(f"{told}; try again, or: {one.remedy}")
        return bool(found)
