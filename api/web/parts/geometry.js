// Where things are: the plan's plane, the globe, and Bézier segments between the two.

const EARTH_M = 6371008.8;
const RAD = Math.PI / 180;

/** A place of a mission in the plan's plane, [east, north] m: exact for local missions, good enough to draw others. */
export function onPlane(plan, place) {
  if (place.east_m !== undefined) return [place.east_m, place.north_m];
  const north = (place.lat_deg - plan.origin.lat_deg) * RAD * EARTH_M;
  const midway = plan.origin.lat_deg * RAD + north / EARTH_M / 2;
  const east = (((place.lon_deg - plan.origin.lon_deg + 540) % 360) - 180) * RAD * EARTH_M * Math.cos(midway);
  return [east, north];
}

/** A point of the plan's plane (azimuthal equidistant about its origin) on the globe, [longitude, latitude]. */
export function onGlobe(plan, east, north) {
  return offset(plan.origin.lon_deg, plan.origin.lat_deg, Math.hypot(east, north), Math.atan2(east, north));
}

/** The place `distance` m from another in the direction `course`, rad from north, over a sphere. */
export function offset(lonDeg, latDeg, distance, course) {
  const arc = distance / EARTH_M;
  const lat = latDeg * RAD;
  const sine = Math.sin(lat) * Math.cos(arc) + Math.cos(lat) * Math.sin(arc) * Math.cos(course);
  const east = Math.atan2(Math.sin(course) * Math.sin(arc) * Math.cos(lat), Math.cos(arc) - Math.sin(lat) * sine);
  return [lonDeg + east / RAD, Math.asin(Math.max(-1, Math.min(1, sine))) / RAD];
}

/** A ring `radius` m around a place, closed, longitudes running on over the antimeridian. */
export function circle(lonDeg, latDeg, radius, count = 96) {
  const ring = [];
  for (let k = 0; k <= count; k += 1) ring.push(offset(lonDeg, latDeg, radius, (2 * Math.PI * (k % count)) / count));
  return ring;
}

/** Metres between two places over a sphere. */
export function distance(a, b) {
  const half = Math.sin(((b.lat_deg - a.lat_deg) * RAD) / 2) ** 2
    + Math.cos(a.lat_deg * RAD) * Math.cos(b.lat_deg * RAD) * Math.sin(((b.lon_deg - a.lon_deg) * RAD) / 2) ** 2;
  return 2 * EARTH_M * Math.asin(Math.min(1, Math.sqrt(half)));
}

/** Control points of the derivative of a Bézier curve flown in `duration` s. */
function derivative(points, duration) {
  const degree = points.length - 1;
  return points.slice(1).map((p, i) => p.map((value, k) => ((value - points[i][k]) * degree) / duration));
}

/** A point of a Bézier curve at u in 0..1, by de Casteljau's construction. */
export function bezier(control, u) {
  let points = control;
  while (points.length > 1) {
    points = points.slice(1).map((p, i) => p.map((value, k) => points[i][k] * (1 - u) + value * u));
  }
  return points[0];
}

/** The legs of a plan: each station in control, and from when to when. */
export function legsOf(plan) {
  const legs = [];
  for (const segment of plan.segments) {
    const last = legs[legs.length - 1];
    const end = segment.start_s + segment.duration_s;
    if (last && last.station === segment.station) last.end = end;
    else legs.push({ station: segment.station, start: segment.start_s, end });
  }
  return legs;
}

/**
 * Samples of a plan, `count` or a few more, in flight order: time, position [east, north, up] m, speed, acceleration
 * and range left to the station in control (against its full range).
 */
export function sample(plan, count = 600) {
  const stations = new Map(plan.mission.stations.map((s) => [s.id, s]));
  const samples = [];
  for (const segment of plan.segments) {
    const velocity = derivative(segment.control_points, segment.duration_s);
    const acceleration = derivative(velocity, segment.duration_s);
    const station = stations.get(segment.station);
    const [east, north] = onPlane(plan, station);
    const up = station.alt_amsl_m !== undefined ? station.alt_amsl_m - plan.origin.alt_amsl_m : station.up_m;
    const steps = Math.max(2, Math.ceil((count * segment.duration_s) / plan.mission_time_s));
    for (let k = samples.length ? 1 : 0; k <= steps; k += 1) {
      const u = k / steps;
      const at = bezier(segment.control_points, u);
      samples.push({
        time: segment.start_s + u * segment.duration_s,
        station: segment.station,
        at,
        speed: Math.hypot(...bezier(velocity, u)),
        acceleration: Math.hypot(...bezier(acceleration, u)),
        margin: station.range_m - Math.hypot(at[0] - east, at[1] - north, at[2] - up),
      });
    }
  }
  return samples;
}

/** Where a plan is at a time: [east, north, up] m. */
export function placeAt(plan, time) {
  const within = Math.min(Math.max(time, 0), plan.mission_time_s);
  const segment = plan.segments.find((s) => within <= s.start_s + s.duration_s) ?? plan.segments[plan.segments.length - 1];
  return bezier(segment.control_points, Math.min(1, Math.max(0, (within - segment.start_s) / segment.duration_s)));
}

/** Whether a plan lies on the globe: local missions are numbers in a plane of their own. */
export const isGeodetic = (plan) => plan.mission.start.lat_deg !== undefined;
