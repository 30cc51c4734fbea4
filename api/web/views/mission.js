// One mission: its plan on the map, the profiles under it, who is in control when, the handovers; and its flights.

import { html, nothing, render } from "../vendor/lit-html/lit-html.js";
import { drawBars, drawMap, markNow } from "../parts/drawing.js";
import { ask, clock, degrees, metres } from "../parts/format.js";
import { isGeodetic } from "../parts/geometry.js";
import { MissionMap, supported } from "../parts/map.js";
import { drawProfiles } from "../parts/profiles.js";
import { problemBox, stateText, stateTone } from "../parts/templates.js";

const REFRESH_MS = 2000;
const WORKING = new Set(["queued", "planning"]);

export async function open(host, { parts: [id], query }) {
  const state = { mission: null, plan: null, flights: [], vehicles: [], problem: null, refused: null };
  const drawn = {};
  let closed = false;

  const draw = () => render(view(state, actions), host);

  const actions = {
    async fly(event) {
      event.preventDefault();
      state.refused = null;
      const vehicle_id = host.querySelector("#vehicle").value;
      try {
        const flight = await ask("v1/flights", {
          method: "POST", headers: { "Content-Type": "application/json" },
          body: JSON.stringify({ mission_id: id, plan_sha256: state.plan.plan_sha256, vehicle_id }),
        });
        location.hash = `#flight/${flight.id}`;
      } catch (problem) {
        state.refused = problem;
        draw();
      }
    },
  };

  /** The one cursor of map, profiles and bars; kept in the address. */
  function cursor(time) {
    drawn.map?.ghost(time);
    if (drawn.bars) markNow(drawn.bars, state.plan, time);
    const there = time === null ? "" : `?t=${time.toFixed(1)}`;
    history.replaceState(null, "", `#mission/${encodeURIComponent(id)}${there}`);
  }

  async function drawPlan() {
    const { plan } = state;
    drawn.profiles?.remove();
    const box = host.querySelector("#map");
    if (isGeodetic(plan) && supported()) {
      if (!drawn.map) {
        drawn.map = new MissionMap(box);
        await drawn.map.ready;
      }
      if (closed) return;
      drawn.map.drawPlan(plan);
    } else {
      host.querySelector("#drawing").removeAttribute("hidden");
      box.hidden = true;
      drawMap(host.querySelector("#drawing"), host.querySelector("#map-caption"), plan);
    }
    drawn.bars = host.querySelector("#bars");
    drawBars(drawn.bars, plan);
    drawn.profiles = drawProfiles(host.querySelector("#profiles"), plan, cursor);
    if (query.has("t")) {
      const time = Number(query.get("t"));
      if (Number.isFinite(time)) { cursor(time); drawn.profiles.mark(time); }
    }
  }

  async function load() {
    try {
      const mission = await ask(`v1/missions/${id}`);
      state.problem = null;
      const fresh = mission.status === "planned" && state.plan?.plan_sha256 !== mission.plan_sha256;
      if (fresh) state.plan = await ask(`v1/missions/${id}/plan`);
      if (mission.status === "planned") {
        state.flights = (await ask(`v1/flights?mission_id=${id}&limit=10`)).items;
        state.vehicles = (await ask("v1/vehicles?limit=200")).items;
      }
      state.mission = mission;
      if (closed) return;
      draw();
      if (fresh) await drawPlan();
    } catch (problem) {
      if (closed) return;
      state.problem = problem instanceof Error ? { title: "This page has a fault", detail: problem.message } : problem;
      draw();
    }
  }

  await load();
  if (!state.mission && state.problem) throw state.problem;
  const timer = setInterval(() => { if (!document.hidden) load(); }, REFRESH_MS);
  return {
    close() {
      closed = true;
      clearInterval(timer);
      drawn.profiles?.remove();
      drawn.map?.remove();
    },
  };
}

function figures(plan) {
  const gap = (100 * (plan.mission_time_s - plan.lower_bound_s)) / plan.mission_time_s;
  const rows = [
    ["Mission time", `${clock(plan.mission_time_s)} (${plan.mission_time_s.toFixed(1)} s)`],
    ["Path", metres(plan.path_length_m)],
    ["Handovers", String(plan.handovers.length)],
    ["Nothing can be faster than", `${clock(plan.lower_bound_s)} (${gap.toFixed(1)} % less)`],
    ["Certificate", plan.certificate.feasible ? "every limit holds on the whole curve" : "NOT feasible"],
    ["Planned in", `${plan.solve_time_s.toFixed(2)} s`],
  ];
  return html`<dl class="figures">${rows.map(([name, value]) => html`<div><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>`;
}

const handoverRow = (h) => html`<tr><td>${h.index}</td><td class="nowrap" title="${h.time_s.toFixed(1)} s">${clock(h.time_s)}</td>
  <td>${h.from}</td><td>${h.to}</td><td class="nowrap">${degrees(h.position)}</td>
  <td class="number">${(h.position.alt_amsl_m ?? h.position.up_m).toFixed(0)}</td>
  <td class="nowrap">${clock(h.overlap.start_s)} to ${clock(h.overlap.end_s)}</td>
  <td class="number">${h.margin.from_m.toFixed(0)} / ${h.margin.to_m.toFixed(0)}</td></tr>`;

function downloads(mission) {
  const base = `v1/missions/${mission.id}`;
  const offers = [["Plan (JSON)", `${base}/plan`],
    ...(mission.formats?.handovers ?? []).map((f) => [`Handovers (${f})`, `${base}/handovers?format=${f}`]),
    ...(mission.formats?.setpoints ?? []).map((f) => [`Setpoints at 20 Hz (${f})`, `${base}/setpoints?rate=20&format=${f}`]),
    ...(mission.formats?.export ?? []).map((f) => [`Export (${f})`, `${base}/export?format=${f}`])];
  return html`<ul id="downloads" class="links">${offers.map(([text, href]) => html`<li><a href=${href}>${text}</a></li>`)}</ul>`;
}

const flying = (state, actions) => html`<section aria-labelledby="flights-title">
  <h2 id="flights-title">Flights</h2>
  ${state.flights.length ? html`<ul class="flights">${state.flights.map((f) => html`<li><a href="#flight/${f.id}">${f.vehicle_id},
      <time datetime=${f.created_utc}>${new Date(f.created_utc).toLocaleString()}</time></a>
      <span class="status ${stateTone(f.state)}">${stateText(f.state)}</span></li>`)}</ul>` : html`<p>Not flown yet.</p>`}
  ${state.vehicles.length ? html`<form class="line" @submit=${actions.fly}>
      <label for="vehicle">Vehicle</label>
      <select id="vehicle">${state.vehicles.map((v) => html`<option value=${v.id}>${v.name || v.id} (${v.autopilot})</option>`)}</select>
      <button type="submit" class="primary">Make the preflight</button></form>
      <p class="soft">Nothing is armed by it.</p>`
    : html`<p>No vehicle is registered: <code>PUT /v1/links/…</code> and <code>PUT /v1/vehicles/…</code>, see the
      <a href="docs">reference</a>.</p>`}
  ${problemBox(state.refused)}
</section>`;

function view(state, actions) {
  const { mission, plan } = state;
  if (!mission) return html`${problemBox(state.problem)}`;
  const phase = mission.progress?.phase && WORKING.has(mission.status) ? `: ${mission.progress.phase}` : "";
  return html`
    <p><a href="#missions">← all missions</a></p>
    <h1>${mission.name || mission.id}</h1>
    <p role="status" class="status ${mission.status}">${mission.status}${phase}</p>
    ${problemBox(state.problem)}
    ${problemBox(mission.problem)}
    ${mission.status === "infeasible" ? html`<p><a class="button primary" href="#plan/${mission.id}">See it on the map and mend it</a></p>` : nothing}
    <div ?hidden=${mission.status !== "planned"}>
      ${plan ? figures(plan) : nothing}
      <p class="buttons"><a class="button" href="#plan/${mission.id}">Change it on the map</a></p>
      <figure class="map-figure">
        <div id="map" class="map" role="region" aria-label="Map of the route and the stations' ranges; the tables below say the same"></div>
        <svg id="drawing" hidden role="img" aria-label="Route and station ranges" preserveAspectRatio="xMidYMid meet"><title>Route and station ranges</title><desc></desc></svg>
        <figcaption id="map-caption">Coloured: who is in control. Circles: range of a station. Rings: handovers. Land: Natural Earth.</figcaption>
      </figure>
      <section aria-labelledby="profiles-title"><h2 id="profiles-title">Profiles</h2>
        <div id="profiles" class="profiles"></div>
        <p class="soft">Red, dashed: the limits. Dotted, upright: handovers. The cursor is tied to the map and to the bars below.</p></section>
      <section aria-labelledby="bars-title"><h2 id="bars-title">Who is in control when</h2>
        <figure><div class="scroll" tabindex="0" role="region" aria-label="Stations in control over time">
          <svg id="bars" role="img" aria-label="Remote pilot stations in control over time; the table below says the same"></svg></div>
          <figcaption>Solid: in control. Pale: both the transferring and the receiving station cover the vehicle around a handover. Times from launch (T+).</figcaption></figure></section>
      <section aria-labelledby="handovers-title"><h2 id="handovers-title">Handovers</h2>
        <div class="scroll" role="region" aria-label="Handover table" tabindex="0"><table id="handovers">
          <thead><tr><th scope="col">#</th><th scope="col">T+</th><th scope="col">Transferring</th><th scope="col">Receiving</th>
            <th scope="col">Place</th><th scope="col">Altitude<br>m AMSL</th><th scope="col">Overlap</th>
            <th scope="col">Range left<br>transferring / receiving, m</th></tr></thead>
          <tbody>${plan?.handovers.length ? plan.handovers.map(handoverRow)
            : html`<tr><td colspan="8">None: one station covers the whole flight.</td></tr>`}</tbody></table></div></section>
      ${mission.status === "planned" ? flying(state, actions) : nothing}
      <section aria-labelledby="downloads-title"><h2 id="downloads-title">Take it along</h2>${downloads(mission)}</section>
    </div>`;
}
