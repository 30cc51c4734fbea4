"""What a flight changes in the vehicle for its own time, and gives back: GCS ids, rally points, geofence.

Everything is read before it is changed and read back after; what was there before is put back on the ground, disarmed,
however the flight ended, but never when the vehicle is lost: then it stays as it is, and that is said.

Each change is in the journal before it is made (`link.session.changes`), and is struck from it when it has been given
back: a flight that dies leaves the note, and the next one begins by giving back what it finds noted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from gcs.flight import EventKind
from gcs.plan import Place, Plan
from link.dialect import mavlink
from link.errors import MissionItemError
from link.handover import gcs_ids
from link.handover.change_note import ChangeNote
from link.handover.gcs_ids import GcsIdManager, GcsIds
from link.microservices.mission_client import MissionClient
from link.microservices.mission_download import MissionDownload, MissionTransfer
from link.microservices.mission_item import AMSL, FENCE, RALLY, RELATIVE, TYPE_NAMES, MissionItem, rally_point
from link.microservices.mission_upload import MissionClear, MissionUpload, difference
from link.microservices.parameter import ParameterClient
from link.microservices.parameter_value import Parameter
from link.preflight import geofence
from link.preflight.check import Check, Level
from link.session.changes import ChangeJournal
from link.session.context import FlightContext
from link.session.procedure import Refused, Steps, wait_until
from link.session.request import HandoverWay

MOST_RALLY_POINTS = 30
"""PX4 keeps 32."""
HEARD_S = 2.0
WRITABLE = "make room, or give access to the folder of the journal"
CAPABILITIES = {
    RALLY: mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_RALLY,
    FENCE: mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FENCE,
}

Values = Mapping[str, Parameter | None]


def _covered(plan: Plan, enu_m: NDArray[np.float64]) -> bool:
    """Whether any station that may be used has a place in range."""
    allowed = [k for k, s in enumerate(plan.mission.stations) if s.id not in plan.mission.options.excluded_stations]
    outside = plan.geometry.outside_m(np.array(allowed), np.broadcast_to(enu_m, (len(allowed), 3)))
    return bool((outside <= 0.0).any())


class BorrowedSettings:
    """What is borrowed for one flight. The steps want a station in control and the vehicle disarmed."""

    def __init__(
        self,
        flight: FlightContext,
        parameters: ParameterClient,
        missions: MissionClient,
        journal: ChangeJournal | None = None,
    ) -> None:
        self._flight = flight
        self._request = flight.request
        self._timeline = flight.timeline
        self._vehicle = flight.vehicle
        self._control = flight.control
        self._parameters = parameters
        self._missions = missions
        self.gcs_ids: GcsIds | None = None
        """As they were; None while nothing of them was changed."""
        self.lists: dict[int, tuple[MissionItem, ...]] = {}
        """Lists as they were, by MAV_MISSION_TYPE."""
        self.settings: dict[str, int | float] = {}
        """Values as they were, by name."""
        self.points: tuple[tuple[str, Place], ...] = ()
        """Rally points the vehicle holds now, by name, in the plan's plane."""
        self._values: Values = {}
        self._transfer: MissionTransfer | None = None
        self.note = ChangeNote(flight, self._parameters, missions, journal)

    def remember(self, values: Values, before: GcsIds) -> None:
        """GCS ids as they were, where they have to be changed before anything can be asked.

        Raises `Refused` where that cannot be noted.
        """
        self._values = values
        if any(one.gcs_ids for one in self.note.left_by_others()):
            return  # the lock is an earlier flight's, and its note says what was there before
        problem = self.note.keep(gcs_ids=gcs_ids.named(before, self._values))
        if problem:
            raise Refused(problem)
        self.gcs_ids = before

    # -- GCS ids ------------------------------------------------------------------------------------------------------

    def take_gcs_ids(self, values: Values) -> Steps[list[Check]]:
        """ArduPilot: tell it whom to hear: the plan's stations and no other, or the first and then each in turn."""
        vehicle, control = self._vehicle, self._control
        self._values = values
        way = self._request.handover_way
        if not vehicle.profile.filters_station_ids or way in (HandoverWay.GATE, HandoverWay.OPERATOR_CONTROL):
            return []
        before = gcs_ids.present(values)
        used = {station: control.system_ids[station] for station in vehicle.monitor.links}
        required = "MAV_GCS_SYSID and MAV_OPTIONS (4.6: SYSID_MYGCS and SYSID_ENFORCE)"
        if before is None:
            fix = "give --handover-way gate to fly without, knowing that the vehicle then obeys anybody"
            told = "the vehicle does not tell whom it hears"
            return [Check("ownership", Level.ERROR, told, None, required, fix=fix)]
        if before.high is None and len(used) > 1 and way != HandoverWay.PARAMETER:
            told = "this firmware knows one station at a time: no range of ids (MAV_GCS_SYSID_HI, ArduPilot 4.7)"
            fix = "give --handover-way parameter: the vehicle is then told of each handover, the only way it has"
            return [Check("ownership", Level.FAILURE, told, None, "MAV_GCS_SYSID_HI (ArduPilot 4.7)", fix=fix)]
        first = control.system_ids[self._flight.plan.station_ids[0]]
        after = before.alone(first) if way == HandoverWay.PARAMETER else gcs_ids.wanted(used, before)
        if self.gcs_ids is None:
            problem = self.note.keep(gcs_ids=gcs_ids.named(before, self._values))
            if problem:
                return [Check("ownership", Level.ERROR, problem, fix=WRITABLE)]
        self.gcs_ids = self.gcs_ids or before
        done = yield from gcs_ids.apply(self._flight, self._parameters, values, before, after)
        if not done:
            fix = "look for another ground station, or a link that loses much, and try again"
            told = "the vehicle did not take the ids it is to hear"
            return [Check("ownership", Level.FAILURE, told, after.low, required, fix=fix)]
        if way == HandoverWay.PARAMETER:
            control.id_manager = GcsIdManager(self._flight, values, after)
            told = f"the vehicle hears station {after.low} and no other, and is told of each handover"
        else:
            told = f"the vehicle hears stations {after.low} to {max(after.low, after.high or 0)} and no other"
        return [Check("ownership", Level.PASS, told, after.low)]

    # -- rally points -------------------------------------------------------------------------------------------------

    def take_rally(self, ground_amsl_m: float) -> Steps[list[Check]]:
        """Upload the mission's covered safe points as rally points, and read them back."""
        if not self._request.rally:
            told = "not looked at, as asked: the vehicle's own return may go to rally points it holds"
            return [Check("rally points", Level.WARNING, told, fix="leave out --no-rally")]
        named, checks = self._safe_points(ground_amsl_m)
        items = [item for _, item in named]
        if not self._keeps(RALLY):
            if items:
                told = "the vehicle keeps no rally points: its own return goes home"
                checks.append(Check("rally points", Level.WARNING, told, 0, fix="known to the crew"))
            return checks
        held = yield from self._download(RALLY)
        if isinstance(held, str):
            fix = "try again, or give --no-rally to fly without knowing where its own return goes"
            told = f"the rally points it holds could not be read: {held}"
            return [*checks, Check("rally points", Level.ERROR, told, None, "read back", fix=fix)]
        if not items:
            self.points = self._places(held, ground_amsl_m)
            told = f"the vehicle holds {len(held)} of its own" if held else "none, neither in the mission nor held"
            return [*checks, Check("rally points", Level.PASS, told, len(held))]
        if not difference(items, held, self._vehicle.profile.mission, RALLY):
            self.points = tuple((name, self._place(item, ground_amsl_m)) for name, item in named)
            return [*checks, Check("rally points", Level.PASS, f"{len(items)}, held already and read back", len(items))]
        check = yield from self._put("rally points", RALLY, items, held)
        there = named if check.level is Level.PASS else ()
        self.points = tuple((name, self._place(item, ground_amsl_m)) for name, item in there) or (
            self._places(held, ground_amsl_m) if check.level is Level.WARNING else ()
        )
        return [*checks, check]

    def _safe_points(self, ground_amsl_m: float) -> tuple[list[tuple[str, MissionItem]], list[Check]]:
        """The rally points to upload, and what is to be said of the safe points that are left out."""
        plan = self._flight.plan
        safe = plan.mission.safe_points
        if not safe:
            return [], []
        ground = plan.geometry
        at = ground.enu_m([point.position for point in safe])
        path = geofence.path_m(plan)
        named, uncovered = [], []
        away = [float(((path[:, :2] - at[k, :2]) ** 2).sum(axis=1).min()) for k in range(len(safe))]
        for k in sorted(range(len(safe)), key=lambda k: away[k]):
            if not _covered(plan, at[k]):
                uncovered.append(safe[k].id)
                continue
            place = ground.geo(at[k])
            if self._vehicle.profile.rally_frame == AMSL:
                item = rally_point(place.lat_deg, place.lon_deg, place.alt_amsl_m, frame=AMSL)
            else:
                height_m = float(round(max(0.0, place.alt_amsl_m - ground_amsl_m)))
                item = rally_point(place.lat_deg, place.lon_deg, height_m, frame=RELATIVE)
            named.append((safe[k].id, item))
        checks = []
        for what, names, fix in (
            ("in no station's range", uncovered, "move it, or raise a station's range"),
            (f"more than the {MOST_RALLY_POINTS} nearest", [n for n, _ in named[MOST_RALLY_POINTS:]], "use fewer"),
        ):
            if names:
                told = f"left out: {', '.join(names)}: {what}, so the autopilot must not go there by itself"
                checks.append(Check("safe points", Level.WARNING, told, names, "in range", fix=fix))
        return named[:MOST_RALLY_POINTS], checks

    def _places(self, held: Sequence[MissionItem], ground_amsl_m: float) -> tuple[tuple[str, Place], ...]:
        return tuple((f"rally point {k + 1}", self._place(item, ground_amsl_m)) for k, item in enumerate(held))

    def _place(self, item: MissionItem, ground_amsl_m: float) -> Place:
        plane = self._flight.plan.plane
        east, north = plane.to_plane(item.lat_deg, item.lon_deg)
        alt_amsl_m = item.alt_m + (0.0 if item.frame == AMSL else ground_amsl_m)
        return float(east), float(north), alt_amsl_m - plane.alt_amsl_m

    # -- geofence -----------------------------------------------------------------------------------------------------

    def take_geofence(self, values: Values, home_enu_m: Place) -> Steps[list[Check]]:
        """Judge the polygons the vehicle holds, or lay one around the plan where that is asked for."""
        profile, lay = self._vehicle.profile, self._request.lay_geofence
        if not self._keeps(FENCE):
            told = "asked for, but the vehicle keeps no fence"
            return [Check("fence", Level.FAILURE, told, fix="fly without --fence")] if lay else []
        if not lay and not geofence.in_force(profile, values):
            return []
        held = yield from self._download(FENCE)
        if isinstance(held, str):
            told = f"the fence it holds could not be read: {held}"
            return [Check("fence", Level.ERROR, told, None, "read back", fix="try again over a better link")]
        if not lay:
            return [geofence.judge_stored(profile, values, self._flight.plan, held)]
        items = geofence.around(self._flight.plan, home_enu_m, [place for _, place in self.points])
        check = yield from self._put("fence", FENCE, items, held)
        if check.level is not Level.PASS:
            return [Check("fence", max(check.level, Level.FAILURE), check.message, fix=check.fix)]
        return [(yield from self._enforce_geofence(values, check))]

    def _enforce_geofence(self, values: Values, laid: Check) -> Steps[Check]:
        """Bring the polygon into force; what its action does is said."""
        profile = self._vehicle.profile
        does, harmless = profile.fence_action(values)
        told = f"{laid.message}; the vehicle answers a breach with: {does}"
        enabled = bool(profile.measure(values, "fence_enabled"))
        for key, value in profile.fence_switches.items():
            parameter = values.get(key)
            # One that is in force already keeps its other kinds: they were judged.
            new = int(parameter.value) | value if parameter is not None and enabled else value
            if parameter is None or not (yield from self._set(parameter, new)):
                fix = "set FENCE_TYPE 4 and FENCE_ENABLE 1 by hand, or fly without --fence"
                return Check("fence", Level.FAILURE, f"{key} was not taken: the fence is not in force", fix=fix)
        if harmless or profile.measure(values, "fence_action") is None:
            fix = f"set {profile.parameter('fence_action').names[0]} if the vehicle is to act on it"
            return Check("fence", Level.WARNING, told, laid.value, fix=fix)
        return Check("fence", Level.PASS, told, laid.value)

    def _set(self, parameter: Parameter, value: int | float) -> Steps[bool]:
        timeline = self._timeline
        if parameter.value == value:
            return True
        noted = self.note.changes.settings
        if parameter.name not in noted:
            settings = {**noted, parameter.name: (parameter.value, value)}
            if self.note.keep(settings=settings):
                return False
        # From now on it may have been taken, answered or not.
        self.settings.setdefault(parameter.name, parameter.value)
        setting = self._parameters.set(parameter.name, value, self._control.in_force)
        yield from wait_until(timeline, lambda: setting.finished, 30.0)
        if setting.confirmed:
            timeline.emit(EventKind.PARAMETER, name=parameter.name, before=parameter.value, after=value)
        return setting.confirmed

    # -- lists --------------------------------------------------------------------------------------------------------

    def _keeps(self, kind: int) -> bool:
        """Whether the vehicle says that it keeps such a list; what says nothing is asked."""
        version = self._vehicle.monitor.version
        return version is None or bool(int(version.capabilities) & CAPABILITIES[kind])

    def _run(self, make: Callable[..., MissionTransfer], kind: int, *arguments: object, **more: object) -> Steps[str]:
        """A transfer from the station in control; why it failed, empty when it did not."""
        control = self._control
        transfer = make(
            *arguments, target=(self._vehicle.system_id, 1), station=(control.own_id, 190), mission_type=kind, **more
        )
        self._missions.start(self._timeline.now_s, control.in_force, transfer)
        self._transfer = transfer
        while transfer.running:
            yield
        return "" if transfer.failure is None else transfer.failure.message

    def _download(self, kind: int) -> Steps[tuple[MissionItem, ...] | str]:
        """What the vehicle holds, or why it could not be read."""
        failed = yield from self._run(MissionDownload, kind)
        if failed:
            return failed
        assert isinstance(self._transfer, MissionDownload)
        try:
            return tuple(self._transfer.items)
        except MissionItemError as error:
            return f"it holds something that is no item: {error}"

    def _put(self, name: str, kind: int, items: Sequence[MissionItem], held: tuple[MissionItem, ...]) -> Steps[Check]:
        """Upload a list over the one held, which is kept to be put back."""
        traits = self._vehicle.profile.mission
        noted = self.note.changes.lists
        before, _ = noted.get(kind, (held, ()))
        problem = self.note.keep(lists={**noted, kind: (before, tuple(items))})
        if problem:
            return Check(name, Level.ERROR, problem, fix=WRITABLE)
        # From now on, however this ends: broken off in its middle it leaves half a list.
        new = kind not in self.lists
        self.lists.setdefault(kind, held)
        failed = yield from self._run(MissionUpload, kind, items, traits=traits)
        assert self._transfer is not None
        failure = self._transfer.failure
        if failure is None:
            back = f"; the {len(held)} it held come back after the flight" if held else ""
            return Check(name, Level.PASS, f"{len(items)} items uploaded and read back{back}", len(items))
        unknown = failure.vehicle_holds == "unknown"
        if unknown:
            now = yield from self._download(kind)
            unknown = isinstance(now, str) or bool(difference(held, now, traits, kind))
        if unknown:
            fix = "try again over a better link; look at what the vehicle holds before anybody flies it"
            return Check(name, Level.ERROR, f"{failed}; nobody knows what the vehicle holds now", None, fix=fix)
        if new:
            del self.lists[kind]
        fix = "known to the crew: its own return goes where it was set to go before"
        return Check(name, Level.WARNING, f"{failed}; the vehicle keeps what it held", len(held), fix=fix)

    # -- back ---------------------------------------------------------------------------------------------------------

    def forget(self) -> None:
        """The vehicle is lost, or armed: nothing is given back, and what stays changed is said."""
        left = [TYPE_NAMES[kind] for kind in self.lists] + list(self.settings)
        if self.gcs_ids is not None:
            left.append("ownership")
        if left:
            self._timeline.alarm("the vehicle keeps what this flight changed", changed=left, fix=self.note.remedy)
        self.gcs_ids, self.lists, self.settings = None, {}, {}

    def give_back(self) -> Steps[None]:
        """Put everything back as it was; on the ground, disarmed."""
        timeline, control = self._timeline, self._control
        control.id_manager = None
        if self.gcs_ids is None and not self.lists and not self.settings:
            return
        self._use_a_link_that_is_heard()
        now: GcsIds | None = None
        if self.gcs_ids is not None:
            # Read anew: after a flight nobody can be sure, and a write left out for a wrong belief is never made.
            now = yield from gcs_ids.reread(self._flight, self._parameters, self._values)
            if now is not None and not now.hears(control.own_id):
                control.grant(control.in_force.station_id, "not heard under its own id", as_vehicle=True)
        settings, self.settings = self.settings, {}
        kept_settings = []
        for name, value in reversed(settings.items()):
            setting = self._parameters.set(name, value, control.in_force)
            yield from wait_until(timeline, lambda s=setting: s.finished, 30.0)  # type: ignore[misc]
            if setting.confirmed:
                timeline.emit(EventKind.PARAMETER, name=name, before=None, after=value)
            else:
                kept_settings.append(name)
                timeline.alarm("parameter not put back", name=name, value=value, fix=self.note.remedy)
        kept_lists = yield from self._lists_back()
        owned = False
        if self.gcs_ids is not None:
            before, self.gcs_ids = self.gcs_ids, None
            # Not knowing, every value is written.
            unlike = GcsIds(0, None if before.high is None else -1, before.options ^ gcs_ids.ENFORCE)
            known = now if now is not None else unlike
            done = yield from gcs_ids.apply(self._flight, self._parameters, self._values, known, before)
            if not done or now is None:
                owned = True
                told = {"low": before.low, "high": before.high, "options": before.options}
                timeline.alarm("ownership not restored", **told, fix=self.note.remedy)
        self.note.strike(kept_settings, kept_lists, owned=owned)

    def _lists_back(self) -> Steps[list[int]]:
        """Put lists back; the kinds that stay changed."""
        kept = []
        lists, self.lists = self.lists, {}
        for kind, held in lists.items():
            traits = self._vehicle.profile.mission
            if held:
                failed = yield from self._run(MissionUpload, kind, held, traits=traits)
            else:
                failed = yield from self._run(MissionClear, kind, traits=traits)
            if failed:
                kept.append(kind)
                told = {"count": len(held), "reason": failed, "fix": self.note.remedy}
                self._timeline.alarm(f"{TYPE_NAMES[kind]} not put back", **told)
        return kept

    def _use_a_link_that_is_heard(self) -> None:
        vehicle, control = self._vehicle, self._control
        station = control.in_force.station_id
        if not vehicle.monitor.heard_within(self._timeline.now_s, station, HEARD_S):
            best = max(vehicle.monitor.links.values(), key=lambda link: link.heard_s)
            control.grant(best.station_id, "the vehicle is heard over its link")
