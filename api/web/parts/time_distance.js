// The time-distance diagram, as rail dispatchers draw it: how far along the path, planned and flown, and the handovers.

import { svg } from "../vendor/lit-html/lit-html.js";
import { clock } from "./format.js";
import { onPlane, sample } from "./geometry.js";

const WIDTH = 900;
const HEIGHT = 220;
const LEFT = 60;
const BOTTOM = 24;

/** Distance along a plan's path at its samples, and a way to say how far along a place is. */
export class PathLength {
  constructor(plan, count = 400) {
    this.plan = plan;
    this.samples = sample(plan, count);
    let total = 0;
    this.along = this.samples.map((s, i) => {
      if (i) total += Math.hypot(s.at[0] - this.samples[i - 1].at[0], s.at[1] - this.samples[i - 1].at[1]);
      return total;
    });
    this.total = total;
  }

  at(time) {
    const i = this.samples.findIndex((s) => s.time >= time);
    return i < 0 ? this.total : this.along[i];
  }

  /** How far along the path the nearest sample to a place is; `near` (a distance) keeps loops apart. */
  of(place, near) {
    const [east, north] = onPlane(this.plan, place);
    let best = 0;
    let least = Infinity;
    this.samples.forEach((s, i) => {
      const away = Math.hypot(s.at[0] - east, s.at[1] - north) + 0.05 * Math.abs(this.along[i] - near);
      if (away < least) [least, best] = [away, i];
    });
    return this.along[best];
  }
}

/** The diagram; `flown` is [time, distance] in order, `now` the time since launch. */
export function timeDistance(path, flown, now, shift) {
  const { plan } = path;
  const last = Math.max(plan.mission_time_s + Math.max(shift, 0), now ?? 0, flown.length ? flown[flown.length - 1][0] : 0);
  const x = (t) => LEFT + (t / last) * (WIDTH - LEFT - 12);
  const y = (d) => HEIGHT - BOTTOM - (d / path.total) * (HEIGHT - BOTTOM - 12);
  const line = (points) => points.map(([t, d]) => `${x(t).toFixed(1)},${y(d).toFixed(1)}`).join(" ");
  const planned = path.samples.map((s, i) => [s.time, path.along[i]]);
  const step = [10, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200].find((s) => last / s <= 8) ?? 14400;
  const ticks = Array.from({ length: Math.floor(last / step) + 1 }, (_, k) => k * step);
  const km = path.total / 1000;
  return svg`
    ${ticks.map((t) => svg`<line class="grid" x1=${x(t)} x2=${x(t)} y1="8" y2=${HEIGHT - BOTTOM}></line>
      <text x=${x(t)} y=${HEIGHT - 8} text-anchor="middle">${clock(t)}</text>`)}
    ${[0, 0.5, 1].map((f) => svg`<text x=${LEFT - 6} y=${y(f * path.total) + 4} text-anchor="end">${(f * km).toFixed(km < 10 ? 1 : 0)} km</text>`)}
    ${plan.handovers.map((h) => svg`<line class="handover" x1=${LEFT} x2=${WIDTH - 12} y1=${y(path.at(h.time_s))} y2=${y(path.at(h.time_s))}></line>
      <text class="handover-name" x=${WIDTH - 14} y=${y(path.at(h.time_s)) - 3} text-anchor="end">${h.from} → ${h.to}</text>`)}
    <polyline class="planned" points=${line(planned)}></polyline>
    <polyline class="flown" points=${line(flown)}></polyline>
    ${now === null ? "" : svg`<line class="now" x1=${x(now)} x2=${x(now)} y1="8" y2=${HEIGHT - BOTTOM}></line>`}`;
}

export const VIEW_BOX = `0 0 ${WIDTH} ${HEIGHT}`;
