"""An independent judge of plan documents: reads the JSON, believes nothing in it, calls no code of ours.

Bézier curves are evaluated here by de Casteljau, the plane is inverted by PROJ (pyproj), slant ranges are chords
between earth-centred points, speeds and elevations on the earth are measured there. Every option and limit of the
mission as submitted is held against the curve. `check_plan` returns every complaint; an empty list is a good plan.
"""

from __future__ import annotations

import hashlib
from typing import Any

import numpy as np
import rfc8785
from numpy.typing import NDArray
from pyproj import Transformer

Array = NDArray[np.float64]
Document = dict[str, Any]

SAMPLES_PER_SEGMENT = 40
# Places recomputed through PROJ, and times through samples, agree with the document to these.
POSITION_TOLERANCE_M = 1e-3
WINDOW_TOLERANCE_S = 2e-3
# Earth-centred points differ by rounding of 1e-9 m over a second: so well are speeds on the earth known.
EARTH_SPEED_TOLERANCE_M_S = 1e-6


def check_plan(plan: Document, mission: Document) -> list[str]:
    """Complaints about ``plan`` as an answer to ``mission`` (the document as submitted)."""
    return _Checker(plan, mission).run()


def de_casteljau(points: Array, u: float) -> Array:
    """The point of one curve ``(n + 1, 3)`` at ``u``."""
    while len(points) > 1:
        points = (1.0 - u) * points[:-1] + u * points[1:]
    return points[0]


def hodograph(points: Array, duration_s: float) -> Array:
    """Control points of the derivative by time."""
    return (len(points) - 1) * np.diff(points, axis=0) / duration_s


def flight_energy_s(plan: Document, mission: Document) -> float:
    """Energy of a plan in seconds of staying aloft: the integral of 1 + (a / a_max)^2 + (v / v_max)^3, by Simpson."""
    limits, total = mission["limits"], 0.0
    for segment in plan["segments"]:
        points, duration = np.array(segment["control_points"], dtype=float), float(segment["duration_s"])
        q = hodograph(points, duration)
        k = hodograph(q, duration)
        u = np.linspace(0.0, 1.0, 101)
        weights = np.tile([2.0, 4.0], 51)[:101]
        weights[[0, -1]] = 1.0
        speed = np.array([np.linalg.norm(de_casteljau(q, x)) for x in u]) / limits["max_speed_m_s"]
        accel = np.array([np.linalg.norm(de_casteljau(k, x)) for x in u]) / limits["max_accel_m_s2"]
        total += duration * float(weights @ (1.0 + accel**2 + speed**3)) / 300.0
    return total


class _Checker:
    def __init__(self, plan: Document, mission: Document) -> None:
        self.plan = plan
        # A null stands for a field left out.
        given = {p: {k: v for k, v in mission.get(p, {}).items() if v is not None} for p in ("limits", "options")}
        self.mission = {**mission, **given}
        self.complaints: list[str] = []
        self.options = {"min_overlap_s": 5.0, "range_margin_m": 25.0, "min_tenure_s": 10.0} | given["options"]
        self.local = "origin" in mission
        origin = plan["origin"]
        self.origin_alt_m = origin["alt_amsl_m"]
        self.to_plane = Transformer.from_pipeline(
            f"+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=aeqd +ellps=WGS84 "
            f"+lat_0={origin['lat_deg']!r} +lon_0={origin['lon_deg']!r}"
        )
        self.to_earth = Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart +ellps=WGS84"
        )
        self.stations = {s["id"]: s for s in mission["stations"]}
        self.segments = plan["segments"]
        self.curves = [np.array(s["control_points"], dtype=float) for s in self.segments]
        self.durations = [float(s["duration_s"]) for s in self.segments]
        self.starts = [float(s["start_s"]) for s in self.segments]

    def expect(self, holds: bool, complaint: str) -> None:
        if not holds:
            self.complaints.append(complaint)

    def run(self) -> list[str]:
        self.check_document()
        self.check_mission()
        self.check_times()
        self.check_joints()
        self.check_limits()
        self.check_coverage()
        self.check_handovers()
        return self.complaints

    # --- geometry -------------------------------------------------------------------------------------------

    def plane(self, position: Document) -> Array:
        if self.local:
            return np.array([position["east_m"], position["north_m"], position["up_m"]])
        east, north = self.to_plane.transform(position["lon_deg"], position["lat_deg"])
        return np.array([east, north, position["alt_amsl_m"] - self.origin_alt_m])

    def earth(self, points: Array) -> Array:
        """Earth-centred coordinates ``(k, 3)`` of plane points ``(k, 3)``; AMSL is taken as ellipsoidal height."""
        lon, lat = self.to_plane.transform(points[:, 0], points[:, 1], direction="INVERSE")
        return np.array(self.to_earth.transform(lon, lat, points[:, 2] + self.origin_alt_m)).T

    def slant_range_m(self, station_id: str, points: Array) -> Array:
        """Distance from a station's antenna to plane points ``(k, 3)``: straight through space for WGS84 missions."""
        station = self.stations[station_id]
        if self.local:
            return np.linalg.norm(points - self.plane(station), axis=1)
        antenna = self.to_earth.transform(station["lon_deg"], station["lat_deg"], station["alt_amsl_m"])
        return np.linalg.norm(self.earth(points) - np.array(antenna), axis=1)

    def elevation_deg(self, station_id: str, points: Array) -> Array:
        """How high above the antenna's horizon plane points ``(k, 3)`` stand; that of the ellipsoid for WGS84."""
        station = self.stations[station_id]
        if self.local:
            offset = points - self.plane(station)
            return np.degrees(np.arctan2(offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])))
        antenna = np.array(self.to_earth.transform(station["lon_deg"], station["lat_deg"], station["alt_amsl_m"]))
        above = np.array(self.to_earth.transform(station["lon_deg"], station["lat_deg"], station["alt_amsl_m"] + 1e3))
        up = (above - antenna) / np.linalg.norm(above - antenna)
        offset = self.earth(points) - antenna
        height = offset @ up
        return np.degrees(np.arctan2(height, np.linalg.norm(offset - height[:, None] * up, axis=1)))

    def unheard(self, station_id: str, points: Array, margin_m: float = 0.0) -> Array:
        """Metres out of range, or degrees too low, of plane points ``(k, 3)``; at most 0 where the station hears."""
        station = self.stations[station_id]
        outside = self.slant_range_m(station_id, points) - (station["range_m"] - margin_m)
        if station.get("min_elevation_deg") is None:
            return outside
        return np.maximum(outside, station["min_elevation_deg"] - self.elevation_deg(station_id, points))

    def true_velocity(self, points: Array, velocity: Array) -> Array:
        """Velocities ``(k, 3)`` at plane points as (east, north, up) on the earth; as they are in a local mission."""
        if self.local:
            return velocity
        step = 0.5
        moved = (self.earth(points + step * velocity) - self.earth(points - step * velocity)) / (2.0 * step)
        lon, lat = np.radians(self.to_plane.transform(points[:, 0], points[:, 1], direction="INVERSE"))
        east = np.stack([-np.sin(lon), np.cos(lon), np.zeros_like(lon)], axis=-1)
        north = np.stack([-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)], axis=-1)
        return np.stack([(moved * east).sum(1), (moved * north).sum(1), velocity[:, 2]], axis=-1)

    def at(self, time_s: float) -> Array:
        k = max(0, int(np.searchsorted(self.starts, time_s, side="right")) - 1)
        return de_casteljau(self.curves[k], min(1.0, max(0.0, (time_s - self.starts[k]) / self.durations[k])))

    def velocity_at(self, time_s: float) -> Array:
        k = max(0, int(np.searchsorted(self.starts, time_s, side="right")) - 1)
        u = min(1.0, max(0.0, (time_s - self.starts[k]) / self.durations[k]))
        return de_casteljau(hodograph(self.curves[k], self.durations[k]), u)

    # --- checks ---------------------------------------------------------------------------------------------

    def check_document(self) -> None:
        bare = {k: v for k, v in self.plan.items() if k not in ("plan_sha256", "solve_time_s", "created_utc")}
        digest = hashlib.sha256(rfc8785.dumps(bare)).hexdigest()
        self.expect(self.plan["plan_sha256"] == digest, f"plan_sha256 is {self.plan['plan_sha256']}, not {digest}")
        self.expect(self.plan["certificate"]["feasible"] is True, "certificate says infeasible")
        for name, value in self.plan["certificate"]["worst"].items():
            self.expect(value <= (1e-9 if name == "continuity" else 0.0), f"certificate.worst.{name} = {value}")
        order = [
            s["station"]
            for k, s in enumerate(self.segments)
            if k == 0 or self.segments[k - 1]["station"] != s["station"]
        ]
        self.expect(order == self.plan["stations"], f"stations {self.plan['stations']} but segments fly {order}")
        self.expect(set(order) <= set(self.stations), "unknown station in the plan")
        self.expect(not set(order) & set(self.options.get("excluded_stations", [])), "an excluded station is used")
        limit = self.options.get("max_handovers")
        self.expect(limit is None or len(order) - 1 <= limit, f"{len(order) - 1} handovers, allowed {limit}")
        filled = {s["id"]: s.get("system_id") for s in self.plan["mission"]["stations"]}
        ids = [filled[station] for station in dict.fromkeys(order)]
        self.expect(None not in ids and len(set(ids)) == len(ids), f"system ids of used stations: {ids}")

    def check_mission(self) -> None:
        """The plan's mission is the one submitted: nothing asked for was dropped or changed on the way."""
        kept = self.plan["mission"]
        for part in ("limits", "options"):
            for name, value in self.mission.get(part, {}).items():
                if name != "start_state":
                    self.expect(kept[part].get(name) == value, f"mission.{part}.{name}: {value} became {kept[part]}")
        for name in ("start", "destination", "origin"):
            if name in self.mission:
                self.expect(kept[name] == self.mission[name], f"mission.{name} changed")
        same = {s["id"]: s for s in kept["stations"]}
        for station in self.mission["stations"]:
            for name in ("range_m", "min_elevation_deg"):
                self.expect(same[station["id"]].get(name) == station.get(name), f"{station['id']}: {name} changed")

    def check_times(self) -> None:
        total = self.plan["mission_time_s"]
        self.expect(min(self.durations) > 0, "a segment without duration")
        expected = np.concatenate([[0.0], np.cumsum(self.durations)])
        self.expect(bool(np.abs(expected[:-1] - self.starts).max() <= 1e-6), "segments do not follow each other")
        self.expect(abs(expected[-1] - total) <= 1e-6, f"mission_time_s {total} but segments last {expected[-1]}")
        # At rest at both ends: nothing covers a straight line of length d sooner than d / v + v / a.
        limits = self.mission["limits"]
        v, a = limits["max_speed_m_s"], limits["max_accel_m_s2"]
        distance = float(np.linalg.norm(self.curves[-1][-1] - self.curves[0][0]))
        straight = distance / v + v / a if distance >= v * v / a else 2.0 * np.sqrt(distance / a)
        if "start_state" not in self.options:
            self.expect(total >= straight * (1 - 1e-9), f"mission_time_s {total} beats a straight line, {straight}")
        bound = self.plan["lower_bound_s"]
        self.expect(bound <= total, f"lower_bound_s {bound} above the mission time {total}")
        if "endurance_s" in limits:
            allowed = limits["endurance_s"] - limits.get("reserve_s", 0.0)
            self.expect(total <= allowed, f"mission_time_s {total} above endurance less reserve {allowed}")
        if self.options.get("arrival_s") is not None:
            wished = self.options["arrival_s"]
            self.expect(abs(total - wished) <= 1e-6, f"mission_time_s {total} but arrival asked for at {wished}")
        lengths = [np.linalg.norm(np.diff(self.sample(k, 400), axis=0), axis=1).sum() for k in range(len(self.curves))]
        self.expect(
            abs(sum(lengths) / max(self.plan["path_length_m"], 1e-9) - 1) < 1e-4 or sum(lengths) < 1e-3, "path_length_m"
        )

    def sample(self, k: int, count: int = SAMPLES_PER_SEGMENT) -> Array:
        return np.array([de_casteljau(self.curves[k], u) for u in np.linspace(0, 1, count + 1)])

    def check_joints(self) -> None:
        limits = self.mission["limits"]
        size = max(1.0, max(float(np.abs(c).max()) for c in self.curves))
        scales = (size, limits["max_speed_m_s"], limits["max_accel_m_s2"])
        state = self.options.get("start_state", {})
        first = [self.plane(self.mission["start"]), np.zeros(3), np.zeros(3)]
        if state:
            for order, key in ((1, "velocity_m_s"), (2, "acceleration_m_s2")):
                first[order] = np.array(state.get(key, [0.0, 0.0, 0.0]), dtype=float)
        last = [self.plane(self.mission["destination"]), np.zeros(3), np.zeros(3)]
        derivatives = []
        for curve, duration in zip(self.curves, self.durations, strict=True):
            q = hodograph(curve, duration)
            derivatives.append((curve, q, hodograph(q, duration)))
        for order, scale in enumerate(scales):
            tolerance = 1e-9 * scale
            # The ends of a WGS84 mission pass through two projections, ours and PROJ's.
            end = tolerance if order or self.local else max(tolerance, POSITION_TOLERANCE_M)
            left = [first[order]] + [d[order][-1] for d in derivatives]
            right = [d[order][0] for d in derivatives] + [last[order]]
            for k, (before, after) in enumerate(zip(left, right, strict=True)):
                allowed = end if k in (0, len(derivatives)) else tolerance
                if k == 0 and order and state:
                    # The start state is along true axes.
                    after = self.true_velocity(self.curves[0][:1], after[None])[0]
                    allowed = max(allowed, 0.0 if self.local else EARTH_SPEED_TOLERANCE_M_S)
                jump = float(np.abs(before - after).max())
                self.expect(jump <= allowed, f"joint {k}: derivative {order} jumps by {jump}")

    def check_limits(self) -> None:
        limits = self.mission["limits"]
        v, a = limits["max_speed_m_s"], limits["max_accel_m_s2"]
        wind = limits.get("wind", {"east_m_s": 0.0, "north_m_s": 0.0})
        for k, (curve, duration) in enumerate(zip(self.curves, self.durations, strict=True)):
            q = hodograph(curve, duration)
            accel = hodograph(q, duration)
            fine = np.linspace(0, 1, SAMPLES_PER_SEGMENT + 1)
            for name, hull, dense in (
                ("control points", q, accel),
                (
                    "samples",
                    np.array([de_casteljau(q, u) for u in fine]),
                    np.array([de_casteljau(accel, u) for u in fine]),
                ),
            ):
                speed, force = np.linalg.norm(hull, axis=1).max(), np.linalg.norm(dense, axis=1).max()
                slack = 0.0 if name == "control points" else 1e-9
                self.expect(speed <= v * (1 + slack), f"segment {k}: speed of {name} {speed} > {v}")
                self.expect(force <= a * (1 + slack), f"segment {k}: acceleration of {name} {force} > {a}")
                if "max_climb_m_s" in limits:
                    self.expect(hull[:, 2].max() <= limits["max_climb_m_s"], f"segment {k}: climbs too fast")
                if "max_descent_m_s" in limits:
                    self.expect(-hull[:, 2].min() <= limits["max_descent_m_s"], f"segment {k}: sinks too fast")
                jerk = hodograph(accel, duration)
                if name == "samples":
                    jerk = np.array([de_casteljau(jerk, u) for u in fine])
                if "max_jerk_m_s3" in limits:
                    worst = np.linalg.norm(jerk, axis=1).max()
                    self.expect(worst <= limits["max_jerk_m_s3"] * (1 + slack), f"segment {k}: jerk of {name} {worst}")
                # On the earth a curve's true speed is known where it is, not at its control points.
                if self.local or name == "samples":
                    points = curve if name == "control points" else self.sample(k)
                    true = hull if self.local else self.true_velocity(points, hull)
                    rounding = 1e-12 if self.local else EARTH_SPEED_TOLERANCE_M_S
                    true_speed = np.linalg.norm(true, axis=1).max()
                    self.expect(true_speed <= v + max(rounding, v * slack), f"segment {k}: true speed {true_speed}")
                    if "max_airspeed_m_s" in limits:
                        blown = np.array([wind["east_m_s"], wind["north_m_s"], 0.0])
                        air = np.linalg.norm(true - blown, axis=1).max()
                        self.expect(
                            air <= limits["max_airspeed_m_s"] + max(rounding, v * slack), f"segment {k}: airspeed {air}"
                        )
            low, high = curve[:, 2].min() + self.origin_alt_m, curve[:, 2].max() + self.origin_alt_m
            self.expect(low >= limits["min_alt_amsl_m"], f"segment {k}: altitude {low} below the band")
            self.expect(high <= limits["max_alt_amsl_m"], f"segment {k}: altitude {high} above the band")

    def check_coverage(self) -> None:
        margin = self.options["range_margin_m"]
        for k, segment in enumerate(self.segments):
            station = self.stations[segment["station"]]
            points = np.concatenate([self.curves[k], self.sample(k)])
            excess = float((self.slant_range_m(segment["station"], points) - (station["range_m"] - margin)).max())
            self.expect(excess <= 1e-9, f"segment {k}: {excess} m outside {segment['station']}'s range less the margin")
            if station.get("min_elevation_deg") is not None:
                below = station["min_elevation_deg"] - self.elevation_deg(segment["station"], points)
                # Millimetres from the antenna a rounding of height is a visible angle.
                noise = np.degrees(1e-12 / np.maximum(self.slant_range_m(segment["station"], points), 1e-9))
                low = float((below - noise).max())
                self.expect(
                    low <= 1e-9, f"segment {k}: {low} degrees below the elevation {segment['station']} hears at"
                )

    def check_handovers(self) -> None:
        joints = [
            k for k in range(1, len(self.segments)) if self.segments[k]["station"] != self.segments[k - 1]["station"]
        ]
        handovers = self.plan["handovers"]
        self.expect(len(joints) == len(handovers), f"{len(joints)} changes of station but {len(handovers)} handovers")
        times = [0.0] + [self.starts[k] for k in joints] + [self.plan["mission_time_s"]]
        if joints:
            shortest = float(np.diff(times).min())
            self.expect(
                shortest >= self.options["min_tenure_s"] - 1e-9, f"a station is in control for {shortest} s only"
            )
        for index, (k, handover) in enumerate(zip(joints, handovers, strict=False), start=1):
            self.check_handover(index, k, handover)

    def check_handover(self, index: int, k: int, handover: Document) -> None:
        label = f"handover {index}"
        time = self.starts[k]
        self.expect(handover["index"] == index, f"{label}: index {handover['index']}")
        self.expect(
            abs(handover["time_s"] - time) <= 1e-9 * max(1.0, time), f"{label}: time {handover['time_s']} not {time}"
        )
        before, after = self.segments[k - 1]["station"], self.segments[k]["station"]
        self.expect((handover["from"], handover["to"]) == (before, after), f"{label}: from/to")
        place = self.at(time)
        position = handover["position"]
        if "lat_deg" in position:
            lon, lat = self.to_plane.transform(place[0], place[1], direction="INVERSE")
            off = max(abs(position["lat_deg"] - lat), abs(position["lon_deg"] - lon)) * 111e3
            self.expect(off <= POSITION_TOLERANCE_M, f"{label}: place off by {off} m")
            self.expect(
                abs(position["alt_amsl_m"] - place[2] - self.origin_alt_m) <= POSITION_TOLERANCE_M, f"{label}: altitude"
            )
        velocity = self.velocity_at(time)
        self.expect(abs(handover["speed_m_s"] - np.linalg.norm(velocity)) <= 0.01, f"{label}: speed")
        if np.hypot(velocity[0], velocity[1]) > 0.5:
            self.check_course(label, place, velocity, handover["course_deg"])
        window = handover["overlap"]
        needed = 0.5 * self.options["min_overlap_s"]
        early, late = time - window["start_s"], window["end_s"] - time
        self.expect(
            min(early, late) >= needed - 1e-9, f"{label}: overlap {early} before and {late} after, asked {needed}"
        )
        margin = self.options["range_margin_m"]
        around = np.array([self.at(t) for t in np.linspace(time - needed, time + needed, 81)])
        for station in (before, after):
            lost = float(self.unheard(station, around, margin).max())
            self.expect(lost <= 1e-6, f"{label}: {lost} outside {station}'s coverage within the overlap asked for")
        for side, station in (("from", before), ("to", after)):
            full = self.stations[station]["range_m"]
            left = full - float(self.slant_range_m(station, place[None])[0])
            self.expect(
                abs(handover["margin"][f"{side}_m"] - left) <= POSITION_TOLERANCE_M, f"{label}: margin.{side}_m, {left}"
            )
            inside = np.linspace(window["start_s"], window["end_s"], 400)
            worst = float(self.unheard(station, np.array([self.at(t) for t in inside])).max())
            self.expect(worst <= 1e-3, f"{label}: {worst} m outside {station}'s range within the overlap")
        # Just outside the window one of the two is lost, unless the mission itself ends there.
        for edge, step in ((window["start_s"], -WINDOW_TOLERANCE_S), (window["end_s"], WINDOW_TOLERANCE_S)):
            probe = edge + step
            if 0.0 <= probe <= self.plan["mission_time_s"]:
                point = self.at(probe)[None]
                covered = all(float(self.unheard(s, point)[0]) <= -1e-3 for s in (before, after))
                self.expect(not covered, f"{label}: both still cover at {probe}, outside the stated overlap")

    def check_course(self, label: str, place: Array, velocity: Array, course_deg: float) -> None:
        """True course from two nearby points of the earth, half a second apart along the velocity."""
        points = np.array([place - 0.25 * velocity, place + 0.25 * velocity])
        lon, lat = self.to_plane.transform(points[:, 0], points[:, 1], direction="INVERSE")
        east = (lon[1] - lon[0]) * np.cos(np.radians(lat.mean()))
        # Metres per degree of latitude and of longitude differ by the ellipsoid's radii of curvature.
        sin2 = np.sin(np.radians(lat.mean())) ** 2
        e2 = 0.00669437999014
        ratio = (1 - e2) / (1 - e2 * sin2)
        true = np.degrees(np.arctan2(east, (lat[1] - lat[0]) * ratio)) % 360.0
        off = abs((course_deg - true + 180.0) % 360.0 - 180.0)
        self.expect(off <= 0.01, f"{label}: course {course_deg}, flown {true}")
