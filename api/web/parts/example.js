// A mission to begin with: two airfields' stations, one handover.

export const EXAMPLE = {
  name: "Den Helder to Texel",
  start: { lat_deg: 52.9234, lon_deg: 4.7806, alt_amsl_m: 100.0 },
  destination: { lat_deg: 53.1153, lon_deg: 4.8336, alt_amsl_m: 100.0 },
  stations: [
    { id: "den-helder", name: "Den Helder airfield", lat_deg: 52.9234, lon_deg: 4.7806, alt_amsl_m: 1.0, range_m: 16000.0 },
    { id: "texel", name: "Texel airfield", lat_deg: 53.1153, lon_deg: 4.8336, alt_amsl_m: 1.0, range_m: 18000.0 },
  ],
  limits: { min_alt_amsl_m: 90.0, max_alt_amsl_m: 120.0, max_speed_m_s: 30.0, max_accel_m_s2: 2.5 },
  safe_points: [{ id: "texel-field", lat_deg: 53.1153, lon_deg: 4.8336, alt_amsl_m: 30.0 }],
};
