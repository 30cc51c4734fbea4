// The map editor: a mission drawn and dragged on the map, its limits and options as forms with units, its plan beside it.
// Nothing is lost on reload: the draft is kept in this browser; undo and redo go through what was done.

import { html, nothing, render } from "../vendor/lit-html/lit-html.js";
import { EXAMPLE } from "../parts/example.js";
import { ask, clock, metres } from "../parts/format.js";
import { distance } from "../parts/geometry.js";
import { MissionMap, supported } from "../parts/map.js";
import { applyFix } from "../parts/fixes.js";
import { problemBox } from "../parts/templates.js";

const DRAFT = "skyrelay.draft";
const WORKING = new Set(["queued", "planning"]);
const POLL_MS = 150;
const SETTLE_MS = 350;
const MOST_UNDO = 200;

const LIMITS = [
  ["min_alt_amsl_m", "Lowest altitude", "m AMSL"], ["max_alt_amsl_m", "Highest altitude", "m AMSL"],
  ["max_speed_m_s", "Speed", "m/s"], ["max_accel_m_s2", "Acceleration", "m/s²"],
  ["max_climb_m_s", "Climb", "m/s"], ["max_descent_m_s", "Descent", "m/s"],
  ["max_airspeed_m_s", "Airspeed", "m/s"], ["endurance_s", "Endurance", "s"], ["reserve_s", "Reserve", "s"],
];
const OPTIONS = [
  ["min_overlap_s", "Least overlap", "s"], ["range_margin_m", "Range margin", "m"], ["min_tenure_s", "Least time in control", "s"],
  ["handover_tolerance", "Time given up for fewer handovers", "part"],
];
const CHOICES = [
  { name: "As set", options: {} },
  { name: "Fastest", options: { handover_tolerance: 0, overlap_target_s: null } },
  { name: "Fewest handovers", options: { handover_tolerance: 0.05 } },
  { name: "Widest overlaps", options: { min_overlap_s: 30 } },
];

export async function open(host, { parts: [id] }) {
  const state = {
    mission: null, id: null, past: [], future: [], plan: null, planned: null, status: "", problem: null, trouble: null,
    choices: null, add: null, off: null, loss: null,
  };
  let map = null;
  let turn = 0;
  let timer = null;
  let closed = false;
  const markers = [];

  if (id) {
    const found = await ask(`v1/missions/${id}`);
    state.mission = strip(found.mission);
  } else {
    state.mission = JSON.parse(localStorage.getItem(DRAFT) ?? "null") ?? structuredClone(EXAMPLE);
  }
  if (state.mission.start.lat_deg === undefined) {
    render(html`<h1>Plan</h1><p class="notice">This mission is given in a local plane; the map draws missions in latitude and longitude. Its <a href="#mission/${id}">plan</a> is drawn all the same.</p>`, host);
    return { close() {} };
  }

  // -- changes --------------------------------------------------------------------------------------------------------

  /** Change the mission: `edit` gets a copy. One step to undo. */
  function change(edit) {
    const next = structuredClone(state.mission);
    edit(next);
    state.past = [...state.past, state.mission].slice(-MOST_UNDO);
    state.future = [];
    take(next);
  }

  function take(mission) {
    state.mission = mission;
    state.choices = state.loss = null;
    localStorage.setItem(DRAFT, JSON.stringify(mission));
    drawMission();
    draw();
    schedule();
  }

  function schedule() {
    clearTimeout(timer);
    timer = setTimeout(replan, SETTLE_MS);
  }

  async function settled(made) {
    let mission = made;
    while (WORKING.has(mission.status) && !closed) {
      await new Promise((resolve) => { setTimeout(resolve, POLL_MS); });
      mission = await ask(`v1/missions/${made.id}`);
    }
    return mission;
  }

  const post = (path, body) => ask(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });

  async function replan() {
    const mine = (turn += 1);
    state.status = "planning …";
    state.problem = null;
    draw();
    try {
      const made = await post(state.id ? `v1/missions/${state.id}/versions` : "v1/missions", state.mission);
      state.id ??= made.id;
      const mission = await settled(made);
      if (mine !== turn || closed) return;
      state.planned = mission;
      if (mission.status === "planned") {
        state.plan = await ask(`v1/missions/${state.id}/plan`);
        state.trouble = null;
        state.status = "planned";
      } else {
        state.plan = null;
        state.trouble = mission.problem;
        state.status = mission.status;
      }
    } catch (problem) {
      if (mine !== turn) return;
      state.plan = null;
      state.problem = problem instanceof Error ? { title: "This page has a fault", detail: problem.message } : problem;
      state.status = "refused";
    }
    drawMission();
    draw();
  }

  const act = {
    undo() {
      if (!state.past.length) return;
      state.future.push(state.mission);
      take(state.past.pop());
    },
    redo() {
      if (!state.future.length) return;
      state.past.push(state.mission);
      take(state.future.pop());
    },
    field(path, text, number = true) {
      const value = number ? (text.trim() === "" ? null : Number(text)) : text;
      if (number && value !== null && !Number.isFinite(value)) return;
      change((m) => {
        const [first, ...rest] = path;
        let at = m;
        let key = first;
        for (const next of rest) { at[key] ??= {}; at = at[key]; key = next; }
        if (value === null || value === "") delete at[key];
        else at[key] = value;
      });
    },
    remove(index) { change((m) => { m.stations.splice(index, 1); }); },
    adding(kind) { state.add = state.add === kind ? null : kind; draw(); },
    fix(fix) { change((m) => applyFix(m, fix)); },
    fresh() { state.id = null; location.hash = "#plan"; change((m) => Object.assign(m, structuredClone(EXAMPLE))); },
    async choices() {
      state.choices = CHOICES.map((c) => ({ ...c, plan: null, problem: null }));
      draw();
      await Promise.all(state.choices.map(async (choice) => {
        try {
          const options = Object.fromEntries(Object.entries({ ...state.mission.options, ...choice.options }).filter(([, v]) => v !== null));
          const made = await settled(await post("v1/missions", { ...state.mission, name: `${state.mission.name ?? "Mission"}: ${choice.name}`, options }));
          if (made.status === "planned") choice.plan = await ask(`v1/missions/${made.id}/plan`);
          else choice.problem = made.problem;
          choice.options = options;
        } catch (problem) { choice.problem = problem; }
        draw();
      }));
    },
    choose(choice) { change((m) => { m.options = choice.options; }); },
    async loss() {
      state.loss = state.plan.stations.map((station) => ({ station, plan: null, problem: null }));
      draw();
      await Promise.all(state.loss.map(async (entry) => {
        try {
          const options = { ...state.mission.options, excluded_stations: [...(state.mission.options?.excluded_stations ?? []), entry.station] };
          const made = await settled(await post("v1/missions", { ...state.mission, name: `${state.mission.name ?? "Mission"} without ${entry.station}`, options }));
          if (made.status === "planned") entry.plan = await ask(`v1/missions/${made.id}/plan`);
          else entry.problem = made.problem;
        } catch (problem) { entry.problem = problem; }
        draw();
      }));
    },
    async open(event) {
      event.preventDefault();
      const file = event.dataTransfer?.files[0] ?? event.target.files?.[0];
      if (!file) return;
      try {
        const document_ = JSON.parse(await file.text());
        const mission = document_.mission ?? document_;
        if (!mission.start || !mission.stations) throw new Error("it holds neither a mission nor a plan");
        change((m) => { for (const k of Object.keys(m)) delete m[k]; Object.assign(m, strip(mission)); });
      } catch (fault) {
        state.problem = { title: `${file.name} cannot be read`, detail: fault.message };
        draw();
      }
    },
    save() {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(new Blob([JSON.stringify(state.mission, null, 2)], { type: "application/json" }));
      link.download = `${(state.mission.name || "mission").replaceAll(/[^\w-]+/g, "-")}.json`;
      link.click();
      URL.revokeObjectURL(link.href);
    },
  };

  // -- the map --------------------------------------------------------------------------------------------------------

  function marker(place, text, kind, moved) {
    const made = map.handle([place.lon_deg, place.lat_deg], text, kind, (lonLat) => {
      const round = (v) => Math.round(v * 1e6) / 1e6;
      change((m) => { const at = moved(m); at.lon_deg = round(lonLat.lng); at.lat_deg = round(lonLat.lat); });
    });
    markers.push(made);
  }

  function drawMission() {
    if (!map?.map) return;
    for (const made of markers.splice(0)) made.remove();
    const view = state.fitted;
    if (state.plan) map.drawPlan(state.plan, { fit: !view });
    else map.drawMission(state.mission, undefined, { fit: !view });
    state.fitted = true;
    map.gap(state.trouble?.place && state.trouble.place.lat_deg !== undefined ? state.trouble : null);
    marker(state.mission.start, "Start", "end", (m) => m.start);
    marker(state.mission.destination, "Destination", "end", (m) => m.destination);
    state.mission.stations.forEach((s, i) => marker(s, `Station ${s.id}`, "station", (m) => m.stations[i]));
  }

  function clicked(lonLat) {
    if (!state.add) return;
    const place = { lat_deg: Number(lonLat.lat.toFixed(6)), lon_deg: Number(lonLat.lng.toFixed(6)) };
    const kind = state.add;
    state.add = null;
    change((m) => {
      if (kind === "station") {
        let k = m.stations.length + 1;
        while (m.stations.some((s) => s.id === `station-${k}`)) k += 1;
        const range = m.stations[m.stations.length - 1]?.range_m ?? 15000;
        m.stations.push({ id: `station-${k}`, ...place, alt_amsl_m: 0, range_m: range });
      } else {
        m.safe_points ??= [];
        m.safe_points.push({ id: `safe-${m.safe_points.length + 1}`, ...place, alt_amsl_m: m.limits.min_alt_amsl_m });
      }
    });
  }

  const draw = () => { if (!closed) render(view(state, act), host); };
  draw();
  if (supported()) {
    map = new MissionMap(host.querySelector("#map"));
    await map.ready;
    map.map.on("click", (event) => clicked(event.lngLat));
  }
  drawMission();
  const keys = (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.target.matches("input, textarea, select")) return;
    if (event.key === "z" && !event.shiftKey) { event.preventDefault(); act.undo(); }
    if (event.key === "y" || (event.key === "z" && event.shiftKey)) { event.preventDefault(); act.redo(); }
  };
  window.addEventListener("keydown", keys);
  await replan();
  return {
    close() {
      closed = true;
      clearTimeout(timer);
      window.removeEventListener("keydown", keys);
      for (const made of markers) made.remove();
      map?.remove();
    },
  };
}

/** A mission as somebody would write it: without system ids that were only filled in. */
function strip(mission) {
  const copy = structuredClone(mission);
  for (const s of copy.stations) for (const [k, v] of Object.entries(s)) if (v === null) delete s[k];
  for (const part of ["limits", "options"]) for (const [k, v] of Object.entries(copy[part] ?? {})) if (v === null) delete copy[part][k];
  return copy;
}

const number = (value, label, unit, set) => html`<label class="field"><span>${label} <small>${unit}</small></span>
  <input type="number" step="any" .value=${value ?? ""} @change=${(e) => set(e.target.value)}></label>`;

const placeFields = (title, place, path, act) => html`<fieldset><legend>${title}</legend>
  ${number(place.lat_deg, "Latitude", "°", (v) => act.field([...path, "lat_deg"], v))}
  ${number(place.lon_deg, "Longitude", "°", (v) => act.field([...path, "lon_deg"], v))}
  ${number(place.alt_amsl_m, "Altitude", "m AMSL", (v) => act.field([...path, "alt_amsl_m"], v))}</fieldset>`;

function stations(state, act) {
  const off = new Set(state.mission.options?.excluded_stations ?? []);
  return html`<div class="scroll" role="region" aria-label="Stations" tabindex="0"><table id="stations"><thead><tr><th scope="col">On</th><th scope="col">Station</th><th scope="col">Range, m</th><th scope="col">Altitude, m AMSL</th><th scope="col"><span class="unseen">Remove</span></th></tr></thead>
  <tbody>${state.mission.stations.map((s, i) => html`<tr>
    <td><input type="checkbox" aria-label="Use ${s.id}" .checked=${!off.has(s.id)} @change=${(e) => {
      const now = new Set(off);
      if (e.target.checked) now.delete(s.id); else now.add(s.id);
      act.field(["options", "excluded_stations"], now.size ? [...now] : "", false);
    }}></td>
    <td><input aria-label="Id of station ${i + 1}" size="14" .value=${s.id} @change=${(e) => act.field(["stations", i, "id"], e.target.value, false)}></td>
    <td><input type="number" step="any" aria-label="Range of ${s.id}, metres" .value=${s.range_m} @change=${(e) => act.field(["stations", i, "range_m"], e.target.value)}></td>
    <td><input type="number" step="any" aria-label="Altitude of ${s.id}, metres AMSL" .value=${s.alt_amsl_m} @change=${(e) => act.field(["stations", i, "alt_amsl_m"], e.target.value)}></td>
    <td><button type="button" aria-label="Remove ${s.id}" @click=${() => act.remove(i)}>×</button></td></tr>`)}</tbody></table></div>`;
}

function outcome(state, act) {
  const { plan, trouble } = state;
  if (plan) {
    const gap = (100 * (plan.mission_time_s - plan.lower_bound_s)) / plan.mission_time_s;
    return html`<dl class="figures">
      <div><dt>Mission time</dt><dd>${clock(plan.mission_time_s)}</dd></div>
      <div><dt>Handovers</dt><dd>${plan.handovers.length}</dd></div>
      <div><dt>Path</dt><dd>${metres(plan.path_length_m)}</dd></div>
      <div><dt>Over what nothing can beat</dt><dd>${gap.toFixed(2)} %</dd></div>
      <div><dt>Certificate</dt><dd>${plan.certificate.feasible ? "holds" : "BROKEN"}</dd></div></dl>
      <p class="soft">By ${plan.stations.join(" → ")}.</p>
      <p class="buttons"><a class="button primary" href="#mission/${state.id}">Open the plan</a></p>`;
  }
  if (!trouble) return nothing;
  const causes = trouble.causes?.length ? trouble.causes : [trouble];
  return html`<div class="notice bad" role="alert"><strong>${trouble.title ?? "Infeasible"}</strong>
    <p>${trouble.detail}</p>
    ${trouble.gap_m ? html`<p>The gap: <b>${metres(trouble.gap_m)}</b>, dotted red on the map.</p>` : nothing}
    <ul class="fixes">${causes.filter((c) => c.fix).map((c) => html`<li>${c.fix_text ?? c.fix.action.replaceAll("_", " ")}
      <button type="button" class="fix" @click=${() => act.fix(c.fix)}>Apply</button></li>`)}</ul></div>`;
}

const compared = (title, entries, name, act, base) => html`<section aria-label=${title}><h3>${title}</h3>
  <div class="scroll" tabindex="0" role="region" aria-label=${title}><table><thead><tr><th scope="col">${name}</th><th scope="col">Time</th><th scope="col">Handovers</th><th scope="col">Least overlap after</th><th scope="col"></th></tr></thead><tbody>
  ${entries.map((e) => html`<tr><td>${e.name ?? e.station}</td>
    ${e.plan ? html`<td class="nowrap">${clock(e.plan.mission_time_s)} <span class="soft">${base ? `${e.plan.mission_time_s - base >= 0 ? "+" : "−"}${Math.abs(e.plan.mission_time_s - base).toFixed(1)} s` : ""}</span></td><td class="number">${e.plan.handovers.length}</td>
        <td class="number">${e.plan.handovers.length ? `${Math.min(...e.plan.handovers.map((h) => h.overlap.end_s - h.time_s)).toFixed(1)} s` : "–"}</td>
        <td>${e.options ? html`<button type="button" @click=${() => act.choose(e)}>Take it</button>` : nothing}</td>`
      : e.problem ? html`<td colspan="4"><span class="status bad">${e.station ? "single point of failure" : "no plan"}</span> ${e.problem.detail ?? ""}</td>`
      : html`<td colspan="4">planning …</td>`}</tr>`)}</tbody></table></div></section>`;

function view(state, act) {
  const { mission } = state;
  return html`<div @dragover=${(e) => e.preventDefault()} @drop=${act.open}>
    <h1>Plan</h1>
    <div class="buttons toolbar" role="toolbar" aria-label="Editing">
      <button type="button" @click=${act.undo} ?disabled=${!state.past.length}>Undo</button>
      <button type="button" @click=${act.redo} ?disabled=${!state.future.length}>Redo</button>
      <button type="button" aria-pressed=${state.add === "station" ? "true" : "false"} @click=${() => act.adding("station")}>Add a station</button>
      <button type="button" aria-pressed=${state.add === "safe" ? "true" : "false"} @click=${() => act.adding("safe")}>Add a safe point</button>
      <button type="button" @click=${act.fresh}>Start from the example</button>
      <button type="button" @click=${act.save}>Save as JSON</button>
      <label class="button">Open a file<input class="unseen" type="file" accept=".json,application/json" @change=${act.open}></label>
    </div>
    ${state.add ? html`<p class="notice" role="status">Click the map where the ${state.add === "safe" ? "safe point" : "station"} stands.</p>` : nothing}
    <div class="columns">
      <div>
        <figure class="map-figure"><div id="map" class="map tall" role="region" aria-label="Map: drag start, destination and stations; the forms beside it say and set the same"></div>
          <figcaption>Drag start, destination and stations. ${distance(mission.start, mission.destination) > 0 ? `${metres(distance(mission.start, mission.destination))} from start to destination.` : ""} The forms set the same from the keyboard.</figcaption></figure>
        ${state.choices ? compared("Choices", state.choices, "Plan", act, state.plan?.mission_time_s) : nothing}
        ${state.loss ? compared("Loss of one station (N-1)", state.loss, "Without", act, state.plan?.mission_time_s) : nothing}
      </div>
      <div>
        <p role="status" class="status ${state.status === "planned" ? "good" : ["infeasible", "failed", "refused"].includes(state.status) ? "bad" : "wait"}">${state.status || "…"}</p>
        ${problemBox(state.problem)}
        ${outcome(state, act)}
        ${state.plan ? html`<p class="buttons"><button type="button" @click=${act.choices}>Compare choices</button>
          <button type="button" @click=${act.loss}>What if a station fails?</button></p>` : nothing}
        <label class="field"><span>Name</span><input .value=${mission.name ?? ""} @change=${(e) => act.field(["name"], e.target.value, false)}></label>
        <details><summary>Start and destination</summary>${placeFields("Start", mission.start, ["start"], act)}${placeFields("Destination", mission.destination, ["destination"], act)}</details>
        <details open><summary>Stations (${mission.stations.length})</summary>${stations(state, act)}</details>
        <details><summary>Limits of the vehicle</summary><div class="fields">${LIMITS.map(([k, label, unit]) => number(mission.limits[k], label, unit, (v) => act.field(["limits", k], v)))}</div></details>
        <details><summary>Options</summary><div class="fields">${OPTIONS.map(([k, label, unit]) => number(mission.options?.[k], label, unit, (v) => act.field(["options", k], v)))}</div></details>
      </div>
    </div></div>`;
}
