// The route and the stations in control, drawn from a plan document; no map tiles, no internet.

import { clock, makeSvg, metres } from "./format.js";
import { bezier, legsOf, onPlane } from "./geometry.js";

const COLOURS = ["#2b6cb0", "#b7791f", "#2f855a", "#9b2c6f", "#5a50b5", "#b04a2b", "#2a7f8a", "#7b6b1d"];

export const colourOf = (index) => COLOURS[index % COLOURS.length];

export function drawMap(svg, caption, plan) {
  const flown = plan.stations;
  const stations = plan.mission.stations.map((s) => ({ ...s, at: onPlane(plan, s) }));
  const used = stations.filter((s) => flown.includes(s.id));
  const xs = used.flatMap((s) => [s.at[0] - s.range_m, s.at[0] + s.range_m]);
  const ys = used.flatMap((s) => [s.at[1] - s.range_m, s.at[1] + s.range_m]);
  const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
  // Metres to a pixel: strokes and letters keep their size on narrow and wide screens.
  const unit = Math.max((right - left) / (svg.clientWidth || 1000), (high - low) / (svg.clientHeight || 400));
  svg.setAttribute("viewBox", `${left} ${-high} ${right - left} ${high - low}`);
  [...svg.querySelectorAll("g")].forEach((g) => g.remove());

  const rings = makeSvg("g");
  const labels = makeSvg("g");
  for (const station of stations) {
    const index = flown.indexOf(station.id);
    const circle = makeSvg("circle", { cx: station.at[0], cy: -station.at[1], r: station.range_m, "stroke-width": 1.2 * unit });
    if (index < 0) circle.setAttribute("class", "unused");
    else {
      circle.setAttribute("fill", colourOf(index));
      circle.setAttribute("fill-opacity", "0.12");
      circle.setAttribute("stroke", colourOf(index));
      labels.append(makeSvg("circle", { cx: station.at[0], cy: -station.at[1], r: 4 * unit, fill: colourOf(index) }));
      if (flown.length <= 20) {
        labels.append(makeSvg("text", { x: station.at[0] + 7 * unit, y: -station.at[1] + 15 * unit, "font-size": 12.5 * unit, "stroke-width": 3 * unit }, station.id));
      }
    }
    circle.append(makeSvg("title", {}, `${station.name || station.id}, range ${metres(station.range_m)}`));
    rings.append(circle);
  }
  const route = makeSvg("g", { fill: "none", "stroke-width": 3.5 * unit, "stroke-linecap": "round", "stroke-linejoin": "round" });
  for (const segment of plan.segments) {
    const points = Array.from({ length: 13 }, (_, k) => bezier(segment.control_points, k / 12)).map((p) => `${p[0].toFixed(1)},${(-p[1]).toFixed(1)}`);
    route.append(makeSvg("polyline", { points: points.join(" "), stroke: colourOf(flown.indexOf(segment.station)) }));
  }
  svg.append(rings, route, labels, makeSvg("g", { id: "vehicle" }));
  svg.querySelector("desc").textContent =
    `The route of ${metres(plan.path_length_m)} passes the ranges of ${flown.join(", ")}, in this order.`;
  caption.textContent = `${flown.length} of ${stations.length} stations are used; ${metres(right - left)} from left to right. North is up.`;
  return { unit };
}

/** The vehicle on the map: `place` is a geodetic or plane position, or null when nothing flies. */
export function drawVehicle(svg, plan, unit, place) {
  const group = svg.querySelector("#vehicle");
  if (!group) return;
  group.replaceChildren();
  if (!place) return;
  const [east, north] = onPlane(plan, place);
  group.append(makeSvg("circle", { class: "vehicle", cx: east, cy: -north, r: 7 * unit, "stroke-width": 2 * unit }));
}

export function drawBars(svg, plan) {
  const row = 22;
  const left = 130;
  const width = 900;
  const total = plan.mission_time_s;
  const x = (t) => left + (Math.min(Math.max(t, 0), total) / total) * (width - left - 20);
  const legs = legsOf(plan);
  const height = legs.length * row + 26;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren();
  legs.forEach((leg, i) => {
    const y = i * row + 3;
    const before = plan.handovers[i - 1];
    const after = plan.handovers[i];
    const from = before ? before.overlap.start_s : leg.start;
    const to = after ? after.overlap.end_s : leg.end;
    const colour = colourOf(plan.stations.indexOf(leg.station));
    svg.append(
      makeSvg("text", { x: left - 8, y: y + 13, "text-anchor": "end", "font-size": 12 }, leg.station),
      makeSvg("rect", { x: x(from), y: y + 4, width: Math.max(1, x(to) - x(from)), height: 8, fill: colour, "fill-opacity": 0.3 }),
      makeSvg("rect", { x: x(leg.start), y, width: Math.max(1, x(leg.end) - x(leg.start)), height: 16, rx: 2, fill: colour },
        makeSvg("title", {}, `${leg.station}: T+ ${clock(leg.start)} to ${clock(leg.end)}`)),
    );
  });
  const base = legs.length * row + 4;
  svg.append(makeSvg("line", { class: "axis", x1: left, x2: x(total), y1: base, y2: base }));
  const raw = total / 6;
  const step = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200].find((s) => s >= raw) || 14400;
  for (let t = 0; t <= total; t += step) {
    svg.append(makeSvg("line", { class: "axis", x1: x(t), x2: x(t), y1: base, y2: base + 4 }),
      makeSvg("text", { x: x(t), y: base + 17, "text-anchor": "middle", "font-size": 12 }, clock(t)));
  }
  svg.append(makeSvg("line", { id: "now", class: "axis", visibility: "hidden", y1: 0, y2: base, "stroke-width": 2 }));
  svg.dataset.left = left;
  svg.dataset.width = width - left - 20;
}

/** Where the flight stands on the bars; null takes the mark away. */
export function markNow(svg, plan, time) {
  const mark = svg.querySelector("#now");
  if (!mark) return;
  mark.setAttribute("visibility", time === null ? "hidden" : "visible");
  const part = Math.min(Math.max(time ?? 0, 0), plan.mission_time_s) / plan.mission_time_s;
  const at = Number(svg.dataset.left) + part * Number(svg.dataset.width);
  mark.setAttribute("x1", at);
  mark.setAttribute("x2", at);
}
