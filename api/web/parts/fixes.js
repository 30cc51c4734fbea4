// The service's fixes, applied to a mission document as they say.

const station = (mission, id) => mission.stations.find((s) => s.id === id);

const ACTIONS = {
  raise_range: (m, f) => { station(m, f.station).range_m = f.range_m; },
  raise_all_ranges: (m, f) => { for (const s of m.stations) s.range_m += f.by_m; },
  lower_margin: (m, f) => { m.options.range_margin_m = f.range_margin_m; },
  lower_option: (m, f) => { m.options[f.option] = f.to; },
  lower_elevation: (m, f) => {
    if (f.to_deg === null) delete station(m, f.station).min_elevation_deg;
    else station(m, f.station).min_elevation_deg = f.to_deg;
  },
  lower_elevations: (m, f) => { for (const s of m.stations) if (s.min_elevation_deg) s.min_elevation_deg = Math.max(0, s.min_elevation_deg - f.by_deg); },
  widen_band: (m, f) => {
    if (f.min_alt_amsl_m !== undefined) m.limits.min_alt_amsl_m = f.min_alt_amsl_m;
    if (f.max_alt_amsl_m !== undefined) m.limits.max_alt_amsl_m = f.max_alt_amsl_m;
  },
  set_altitude: (m, f) => { (m[f.of] ?? station(m, f.of)).alt_amsl_m = f.alt_amsl_m; },
  move: (m, f) => { Object.assign(m[f.of] ?? station(m, f.of), place(f)); },
  add_station: (m, f) => {
    let k = m.stations.length + 1;
    while (station(m, `station-${k}`)) k += 1;
    m.stations.push({ id: `station-${k}`, alt_amsl_m: 0, ...place(f), range_m: f.range_m });
  },
  include_station: (m, f) => { m.options.excluded_stations = m.options.excluded_stations.filter((id) => id !== f.station); },
  raise_limit: (m, f) => { m.limits[f.limit] = f.to; },
  lower_limit: (m, f) => { m.limits[f.limit] = f.to; },
  lower_wind: (m, f) => { m.limits.wind = { east_m_s: f.east_m_s, north_m_s: f.north_m_s }; },
  later_arrival: (m, f) => { m.options.arrival_s = f.arrival_s; },
  earlier_arrival: (m, f) => { m.options.arrival_s = f.arrival_s; },
};

/** The place a fix names, wherever it stands in it. */
function place(fix) {
  const at = fix.position ?? fix.place ?? fix.to ?? fix.at ?? fix;
  return Object.fromEntries(["lat_deg", "lon_deg", "alt_amsl_m"].filter((k) => at[k] !== undefined).map((k) => [k, at[k]]));
}

/** Change `mission` as a fix says; throws where this page does not know the fix. */
export function applyFix(mission, fix) {
  mission.options ??= {};
  const action = ACTIONS[fix.action];
  if (!action) throw new Error(`the page cannot apply '${fix.action}': change the mission by hand`);
  action(mission, fix);
}
