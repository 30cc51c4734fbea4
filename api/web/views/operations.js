// The operations board: every flight that goes on and every station it needs, on one time axis.

import { html, nothing, render, svg } from "../vendor/lit-html/lit-html.js";
import { colourOf } from "../parts/drawing.js";
import { ask, clock } from "../parts/format.js";
import { legsOf } from "../parts/geometry.js";
import { problemBox, stateText, stateTone, tPlus } from "../parts/templates.js";

const REFRESH_MS = 2000;
const ROW = 26;
const LEFT = 150;
const WIDTH = 1000;
const BEFORE_S = 900;
const LEAST_S = 3600;

export async function open(host) {
  const state = { flights: null, problem: null };
  const plans = new Map();
  let closed = false;

  async function load() {
    try {
      const items = (await ask("v1/flights?active=true&limit=50")).items;
      state.flights = await Promise.all(items.map(async (item) => {
        const flight = await ask(`v1/flights/${item.id}`);
        const sha = flight.live?.replanned_sha256 ?? flight.plan_sha256;
        if (!plans.has(sha)) plans.set(sha, await ask(`v1/flights/${item.id}/plan`));
        return { flight, plan: plans.get(sha) };
      }));
      state.problem = null;
    } catch (problem) {
      state.problem = problem;
    }
    if (!closed) render(view(state), host);
  }

  render(view(state), host);
  await load();
  const timer = setInterval(() => { if (!document.hidden) load(); }, REFRESH_MS);
  return { close() { closed = true; clearInterval(timer); } };
}

/** When T+0 of a flight was or, before its launch, would be now; ms. */
function launchedAt({ flight }) {
  const { live } = flight;
  if (live?.t_plus_s === null || live?.t_plus_s === undefined) return Date.now();
  return Date.now() - 1000 * live.t_plus_s;
}

/** Duties of stations: who is wanted when, by which flight. */
function duties(flights) {
  const found = [];
  flights.forEach((entry, index) => {
    const start = launchedAt(entry) + 1000 * (entry.flight.live?.shift_s ?? 0);
    for (const leg of legsOf(entry.plan)) {
      found.push({ station: leg.station, from: start + 1000 * leg.start, to: start + 1000 * leg.end, index, flight: entry.flight, name: entry.plan.mission.name });
    }
  });
  return found;
}

/** Duties of one station that overlap, of different flights. */
export function clashes(list) {
  const found = new Set();
  const sorted = [...list].sort((a, b) => a.from - b.from);
  sorted.forEach((a, i) => {
    for (const b of sorted.slice(i + 1)) {
      if (b.from >= a.to) break;
      if (a.flight.id !== b.flight.id) { found.add(a); found.add(b); }
    }
  });
  return found;
}

function board(flights) {
  const all = duties(flights);
  const stations = [...new Set(all.map((d) => d.station))].sort();
  const now = Date.now();
  const first = now - 1000 * BEFORE_S;
  const last = Math.max(now + 1000 * LEAST_S, ...all.map((d) => d.to));
  const x = (t) => LEFT + ((Math.min(Math.max(t, first), last) - first) / (last - first)) * (WIDTH - LEFT - 10);
  const height = stations.length * ROW + 30;
  const step = [300, 600, 900, 1800, 3600, 7200].find((s) => (last - first) / 1000 / s <= 9) ?? 14400;
  const ticks = [];
  for (let t = Math.ceil(first / (1000 * step)) * 1000 * step; t < last; t += 1000 * step) ticks.push(t);
  const double = clashes(all);
  const picture = svg`<svg viewBox="0 0 ${WIDTH} ${height}" class="diagram board" role="group" aria-label="Stations in control over time; the table below says the same">
    ${ticks.map((t) => svg`<line class="grid" x1=${x(t)} x2=${x(t)} y1="0" y2=${height - 22}></line><text x=${x(t)} y=${height - 6} text-anchor="middle">${new Date(t).toISOString().slice(11, 16)}</text>`)}
    ${stations.map((s, i) => svg`<text x=${LEFT - 8} y=${i * ROW + 17} text-anchor="end">${s}</text>`)}
    ${all.filter((d) => d.to > first).map((d) => svg`<a href="#station/${d.flight.id}/${encodeURIComponent(d.station)}"><rect x=${x(d.from)} y=${stations.indexOf(d.station) * ROW + 4} width=${Math.max(2, x(d.to) - x(d.from))} height=${ROW - 8} rx="2"
      fill=${colourOf(d.index)} class=${double.has(d) ? "double" : ""}><title>${d.station}: ${d.name}, ${new Date(d.from).toISOString().slice(11, 19)} to ${new Date(d.to).toISOString().slice(11, 19)} UTC${double.has(d) ? ", DOUBLE-BOOKED" : ""}</title></rect></a>`)}
    <line class="now" x1=${x(now)} x2=${x(now)} y1="0" y2=${height - 22}></line></svg>`;
  return { picture, all, double, stations };
}

function workload({ all, double, stations }) {
  const now = Date.now();
  return html`<div class="scroll" role="region" aria-label="Stations" tabindex="0"><table id="workload"><thead><tr><th scope="col">Station</th><th scope="col">Wanted next</th><th scope="col">By</th>
    <th scope="col">In control, in all</th><th scope="col"></th></tr></thead><tbody>
    ${stations.map((s) => {
      const mine = all.filter((d) => d.station === s && d.to > now).sort((a, b) => a.from - b.from);
      const next = mine[0];
      const total = mine.reduce((sum, d) => sum + (d.to - Math.max(d.from, now)) / 1000, 0);
      const twice = mine.some((d) => double.has(d));
      return html`<tr><td>${s}</td><td>${!next ? "–" : next.from <= now ? "now" : `in ${clock((next.from - now) / 1000)}`}</td><td>${next?.name ?? ""}</td>
        <td class="number">${clock(total)}</td><td>${twice ? html`<span class="status bad">double-booked</span>` : nothing}</td></tr>`;
    })}</tbody></table></div>`;
}

function flightRow({ flight, plan }) {
  const { live } = flight;
  const next = live?.next_handover;
  const alarm = flight.alarms[flight.alarms.length - 1];
  return html`<tr><td><a href="#flight/${flight.id}">${plan.mission.name || flight.mission_id}</a></td><td>${flight.vehicle_id}</td>
    <td class="nowrap"><span class="status ${stateTone(flight.phase)}">${stateText(flight.phase)}</span></td>
    <td class="nowrap">${tPlus(live?.t_plus_s)} of ${clock(plan.mission_time_s)}</td><td>${live?.station ?? "–"}</td>
    <td>${next ? `${next.to} in ${clock(Math.max(0, next.in_s))}` : "–"}</td>
    <td>${alarm ? html`<span class="status bad">${alarm.what}</span>` : "–"}</td></tr>`;
}

function view(state) {
  const flights = state.flights ?? [];
  const drawn = flights.length ? board(flights) : null;
  return html`<h1>Operations</h1>
    ${problemBox(state.problem)}
    ${state.flights === null && !state.problem ? html`<p role="status">loading …</p>` : nothing}
    ${state.flights?.length === 0 ? html`<p class="notice">Nothing flies now. Choose a <a href="#missions">mission</a> and make its preflight.</p>` : nothing}
    ${drawn ? html`
      <div class="scroll" role="region" aria-label="Flights" tabindex="0"><table id="flights"><thead><tr><th scope="col">Flight</th><th scope="col">Vehicle</th><th scope="col">State</th><th scope="col">Time</th>
        <th scope="col">In control</th><th scope="col">Next handover</th><th scope="col">Last alarm</th></tr></thead><tbody>${flights.map(flightRow)}</tbody></table></div>
      <section aria-labelledby="board-title"><h2 id="board-title">Which station is wanted when (UTC)</h2>
        ${drawn.double.size ? html`<p class="notice bad" role="alert"><strong>Double-booked:</strong> ${[...new Set([...drawn.double].map((d) => d.station))].join(", ")}.</p>` : nothing}
        <div class="scroll" tabindex="0" role="region" aria-label="Stations over time">${drawn.picture}</div>
        <p class="soft">A flight not launched yet is drawn as if it were launched now.</p></section>
      <section aria-labelledby="workload-title"><h2 id="workload-title">Stations</h2>${workload(drawn)}</section>` : nothing}`;
}
