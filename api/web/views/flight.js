// The flight director's view: the vehicle beside its plan, how old every figure is, preflight, launch, commands, alerts.

import { html, nothing, render } from "../vendor/lit-html/lit-html.js";
import { Alerts } from "../parts/alerts.js";
import { drawMap, drawVehicle } from "../parts/drawing.js";
import { ask, clock } from "../parts/format.js";
import { FlightFeed } from "../parts/flight_feed.js";
import { isGeodetic } from "../parts/geometry.js";
import { MissionMap, supported } from "../parts/map.js";
import { problemBox, stateText, stateTone, tPlus } from "../parts/templates.js";
import { PathLength, timeDistance, VIEW_BOX } from "../parts/time_distance.js";

const DRAW_MS = 100;
const SURE_MS = 6000;
const STALE_S = 2;
const FRESH_PREFLIGHT_S = 60;
const GROUND = new Set(["connecting", "identifying", "preflight", "ready"]);
const AIR = new Set(["takeoff", "transit", "cruise", "holding", "returning", "lapsed", "arrived", "landing"]);

// Which command is offered in which phase, as the service takes them; `sure` asks twice.
const COMMANDS = [
  { name: "hold", text: "Hold", in: ["transit", "cruise", "returning"], help: "stand on the path" },
  { name: "resume", text: "Resume", in: ["holding", "lapsed"], help: "go on" },
  { name: "abort", text: "Abort", in: [...GROUND, "arming", ...AIR], sure: true, help: "fly the contingency procedure in force; on the ground: give the flight up" },
  { name: "land", text: "Land here", in: ["arming", ...AIR], sure: true, help: "land at once, wherever that is" },
];

export async function open(host, { parts: [id] }) {
  let map = null;
  let drawing = null;
  let path = null;
  let mapped = null;
  const flown = [];
  const ui = { sure: null, refused: null, arming: false, proposal: null, excluded: "" };
  let queued = false;

  const feed = new FlightFeed(id, () => {
    // Telemetry may come faster than eyes see: at most ten drawings a second.
    if (queued) return;
    queued = true;
    setTimeout(() => { queued = false; if (!feed.closed) draw(); }, DRAW_MS);
  });
  const alerts = new Alerts(id, () => draw());

  const act = {
    async command(name, body) {
      ui.refused = null;
      ui.sure = null;
      try {
        await feed.command(name, body);
      } catch (problem) {
        ui.refused = problem;
      }
      draw();
    },
    sure(name) {
      ui.sure = name;
      setTimeout(() => { if (ui.sure === name) { ui.sure = null; draw(); } }, SURE_MS);
      draw();
    },
    launch() {
      const { plan_sha256, preflight } = feed.flight;
      return act.command("launch", { plan_sha256, preflight_id: preflight.id });
    },
    async propose(event) {
      event.preventDefault();
      ui.refused = ui.proposal = null;
      try {
        const excluded = [...event.target.elements.excluded.selectedOptions].map((o) => o.value);
        ui.proposal = await ask(`v1/flights/${id}/replan`, {
          method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify({ excluded_stations: excluded }),
        });
        map?.propose(ui.proposal.plan);
      } catch (problem) {
        ui.refused = problem;
      }
      draw();
    },
    async accept() {
      const sha = ui.proposal.plan_sha256;
      act.dismiss();
      await act.command("replan/accept", { plan_sha256: sha });
    },
    dismiss() {
      ui.proposal = null;
      map?.propose(null);
      draw();
    },
  };

  async function drawPlan() {
    const { plan } = feed;
    mapped = plan.plan_sha256;
    path = new PathLength(plan);
    const box = host.querySelector("#map");
    if (isGeodetic(plan) && supported()) {
      if (!map) {
        map = new MissionMap(box);
        await map.ready;
      }
      if (!feed.closed) map.drawPlan(plan);
    } else {
      host.querySelector("#drawing").removeAttribute("hidden");
      box.hidden = true;
      drawing = drawMap(host.querySelector("#drawing"), document.createElement("p"), plan);
    }
  }

  function draw() {
    const { flight, plan, live } = feed;
    alerts.take(flight.alarms ?? [], new Date().toISOString(), feed.ended);
    if (live?.position && live.plan_s !== null && live.t_plus_s !== null && path) {
      const last = flown[flown.length - 1];
      if (!last || live.t_plus_s - last[0] >= 1) flown.push([live.t_plus_s, path.of(live.position, last ? last[1] : 0)]);
      if (flown.length > 4000) flown.splice(0, flown.length, ...flown.filter((_, i) => i % 2 === 0));
    }
    render(view({ feed, ui, act, alerts, path, flown }), host);
    if (mapped !== plan.plan_sha256) {
      drawPlan().then(draw);
      return;
    }
    if (map?.map && !feed.ended) {
      map.vehicle(live?.position ?? null);
      map.ghost(live?.plan_s ?? null);
    } else if (drawing) drawVehicle(host.querySelector("#drawing"), plan, drawing.unit, live?.position ?? null);
  }

  await feed.begin();
  draw();
  // Ages go on while nothing comes.
  const timer = setInterval(draw, 1000);
  return {
    close() {
      clearInterval(timer);
      feed.close();
      map?.remove();
    },
  };
}

/** A figure, its unit, and since when it is old where it is. */
const figure = (name, value, unit, ageS) => {
  const stale = ageS !== null && ageS > STALE_S;
  return html`<div class=${stale ? "stale" : ""}><dt>${name}</dt>
    <dd>${value === null || value === undefined ? "–" : html`${value} <small>${unit}</small>`}
    ${stale ? html`<span class="age">${ageS > 3600 ? "long ago" : `${ageS.toFixed(0)} s old`}</span>` : nothing}</dd></div>`;
};

function figures(feed) {
  const { live } = feed;
  // On the ground the flight speaks when something changes, not by the second.
  const quiet = feed.ended || (feed.connected && GROUND.has(live?.phase));
  const age = quiet ? null : Math.max(feed.ageS ?? 0, 0);
  const positionAge = quiet ? null : age + (live?.position_age_s ?? 0);
  const fixed = (v, n = 1) => (v === null || v === undefined ? null : v.toFixed(n));
  return html`<dl class="figures live">
    ${figure("In control", live?.station ?? null, "", age)}
    ${figure("Speed", fixed(live?.speed_m_s), "m/s", positionAge)}
    ${figure("Altitude", fixed(live?.position?.alt_amsl_m), "m AMSL", positionAge)}
    ${figure("Off the plan", fixed(live?.error_m), "m", positionAge)}
    ${figure("Range left", fixed(live?.margin_m, 0), "m", positionAge)}
    ${figure("Battery", live?.battery_percent ?? null, "%", age)}
  </dl>`;
}

const LEVEL_TEXT = { pass: "passed", warning: "warning", failure: "failed" };

function preflight(flight) {
  const { preflight: p } = flight;
  const order = { failure: 0, warning: 1, pass: 2 };
  const checks = [...p.checks].sort((a, b) => (order[a.level] ?? 1) - (order[b.level] ?? 1));
  const short = checks.filter((c) => c.level !== "pass");
  const item = (c) => html`<li class="check ${c.level}"><strong>${c.name ?? c.check}</strong> <span class="level">${LEVEL_TEXT[c.level] ?? c.level}</span>: ${c.message ?? c.said ?? ""}
    ${c.fix && c.level !== "pass" ? html`<br><span class="fix">What to do: ${c.fix}</span>` : nothing}</li>`;
  return html`<section aria-labelledby="preflight-title"><h2 id="preflight-title">Preflight</h2>
    ${p.checks.length ? html`
      <p class="status ${p.passed ? "good" : flight.phase === "refused" ? "bad" : "wait"}">${p.passed ? "passed" : flight.phase === "refused" ? "refused" : "under way"}${p.age_s !== null && p.age_s !== undefined && p.passed && GROUND.has(flight.phase) ? `, ${p.age_s.toFixed(0)} s old` : ""}</p>
      ${short.length ? html`<ul class="checks">${short.map(item)}</ul>` : nothing}
      <details><summary>All ${checks.length} checks</summary><ul class="checks">${checks.map(item)}</ul></details>`
    : html`<p role="status">${stateText(flight.phase)}: asking the vehicle …</p>`}
  </section>`;
}

function launch({ feed, ui, act }) {
  const { flight } = feed;
  if (flight.phase !== "ready") return nothing;
  const old = (flight.preflight.age_s ?? 0) >= FRESH_PREFLIGHT_S;
  return html`<section aria-labelledby="launch-title" class="launch"><h2 id="launch-title">Launch</h2>
    ${old ? html`<p>The preflight is ${flight.preflight.age_s.toFixed(0)} s old; a launch needs one under ${FRESH_PREFLIGHT_S} s.</p>
        <button type="button" class="primary" @click=${() => act.command("preflight")}>Make the preflight again</button>`
    : ui.sure === "launch" ? html`<p><strong>The vehicle will arm and take off.</strong> People clear of it?</p>
        <p class="buttons"><button type="button" class="danger" @click=${act.launch}>Launch now</button>
        <button type="button" @click=${() => act.sure(null)}>Not yet</button></p>`
    : html`<button type="button" class="primary" @click=${() => act.sure("launch")}>Prepare to launch …</button>`}
  </section>`;
}

function commands({ feed, ui, act }) {
  const { phase } = feed.flight;
  if (feed.ended) return nothing;
  return html`<section aria-labelledby="commands-title"><h2 id="commands-title">Commands</h2>
    <div class="buttons commands">${COMMANDS.map((c) => {
      const offered = c.in.includes(phase);
      if (c.sure && ui.sure === c.name) {
        return html`<button type="button" class="danger" @click=${() => act.command(c.name)}>${c.text}: sure?</button>`;
      }
      return html`<button type="button" ?disabled=${!offered} title=${c.help} @click=${() => (c.sure ? act.sure(c.name) : act.command(c.name))}>${c.text}</button>`;
    })}</div>
    <p class="soft">Abort flies the contingency procedure in force. Both abort and land ask once more.</p>
    ${problemBox(ui.refused)}
    ${["cruise", "holding"].includes(phase) ? replan({ feed, ui, act }) : nothing}
  </section>`;
}

const replan = ({ feed, ui, act }) => html`<details class="replan" ?open=${Boolean(ui.proposal)}><summary>Plan on from here</summary>
  <form class="line" @submit=${act.propose}><label for="excluded">Without stations</label>
    <select id="excluded" name="excluded" multiple size="3">${feed.plan.mission.stations.map((s) => html`<option value=${s.id}>${s.id}</option>`)}</select>
    <button type="submit">Propose a plan</button></form>
  ${ui.proposal ? html`<p>Proposed: ${clock(ui.proposal.plan.mission_time_s)} in all, ${ui.proposal.plan.handovers.length} handovers, by ${ui.proposal.plan.stations.join(", ")}.
    Dashed on the map.</p><p class="buttons"><button type="button" class="primary" @click=${act.accept}>Fly it</button>
    <button type="button" @click=${act.dismiss}>Dismiss</button></p>` : nothing}</details>`;

function lapse(live) {
  const l = live?.lapse;
  if (!l) return nothing;
  const rows = Object.entries(l).filter(([, v]) => v !== null && typeof v !== "object");
  return html`<section class="notice bad" role="status"><strong>Lost C2 link.</strong> No countdown stands while it is lost.
    <dl class="pairs">${rows.map(([k, v]) => html`<div><dt>${k.replaceAll("_", " ")}</dt><dd>${typeof v === "number" ? Number(v.toFixed(1)) : String(v)}</dd></div>`)}</dl></section>`;
}

function handovers({ feed }) {
  const { plan, flight, live } = feed;
  const times = new Map((live?.handovers ?? []).map((h) => [h.index, h.t_plus_s]));
  return html`<section aria-labelledby="handovers-title"><h2 id="handovers-title">Handovers</h2>
    <div class="scroll" role="region" aria-label="Handovers" tabindex="0"><table id="handovers"><thead><tr><th scope="col">#</th><th scope="col">Planned</th><th scope="col">Expected</th>
      <th scope="col">Transferring</th><th scope="col">Receiving</th><th scope="col">State</th></tr></thead>
    <tbody>${plan.handovers.map((h) => html`<tr><td>${h.index}</td><td>${tPlus(h.time_s)}</td><td>${times.has(h.index) ? tPlus(times.get(h.index)) : "–"}</td>
      <td>${h.from}</td><td><a href="#station/${feed.id}/${encodeURIComponent(h.to)}">${h.to}</a></td><td>${flight.handover_states[h.index] ?? "to come"}</td></tr>`)}
      ${plan.handovers.length ? nothing : html`<tr><td colspan="6">None.</td></tr>`}</tbody></table></div></section>`;
}

function links({ feed }) {
  const table = feed.live?.links;
  if (!table || !Object.keys(table).length) return nothing;
  const age = feed.ageS ?? 0;
  const cell = (v, unit, digits = 0) => (v === null || v === undefined ? "–" : `${v.toFixed(digits)} ${unit}`);
  return html`<section aria-labelledby="links-title"><h2 id="links-title">C2 links</h2>
    <div class="scroll" role="region" aria-label="C2 links" tabindex="0"><table id="links"><thead><tr><th scope="col">Station</th><th scope="col">Transmits</th><th scope="col">Last heard</th>
      <th scope="col">Round trip</th><th scope="col">Lost, frames / probes</th></tr></thead><tbody>
    ${Object.entries(table).map(([station, l]) => {
      const heard = l.heard_s_ago === null || l.heard_s_ago === undefined ? null : l.heard_s_ago + age;
      return html`<tr class=${heard === null || heard > 3 ? "stale" : ""}><td>${station}</td><td>${feed.live.station === station && !feed.ended ? html`<strong>in control</strong>` : ""}</td>
        <td>${heard === null ? "not heard" : `${heard.toFixed(1)} s ago`}</td><td class="number">${cell(l.round_trip_ms, "ms")}</td>
        <td class="number">${[l.loss, l.round_loss].map((v) => cell(v === null || v === undefined ? null : 100 * v, "%", 1)).join(" / ")}</td></tr>`;
    })}</tbody></table></div></section>`;
}

function view(all) {
  const { feed, alerts, path, flown } = all;
  const { flight, live, plan } = feed;
  const next = live?.next_handover;
  const result = flight.result;
  const silent = !feed.ended && (!feed.connected || (feed.ageS ?? 0) > 20);
  return html`
    <p><a href="#mission/${flight.mission_id}">← the mission</a></p>
    <h1>Flight of ${plan.mission.name || flight.mission_id}</h1>
    <p class="unseen" role="status">${stateText(live?.outcome || flight.phase)}${live?.station ? `, ${live.station} in control` : ""}</p>
    <div class="headline ${stateTone(live?.phase ?? flight.phase)}">
      <span class="status ${stateTone(result?.outcome ?? live?.phase ?? flight.phase)}">${stateText(result?.outcome ?? live?.phase ?? flight.phase)}</span>
      <span>${tPlus(live?.t_plus_s)} of ${clock(plan.mission_time_s)}</span>
      <span>${feed.ended ? "ended" : live?.phase === "lapsed" ? "no countdown: lost C2 link" : next ? `${next.to} takes control in ${clock(Math.max(0, next.in_s - (feed.ageS ?? 0)))}` : plan.handovers.length ? "no handover timed now" : "no handover"}</span>
      <span class="soft">${live?.reason ?? ""}</span>
    </div>
    ${silent ? html`<p class="notice bad" role="alert"><strong>No live data.</strong> ${feed.problem?.detail ?? "The connection to the service is lost."} Figures below are ${feed.ageS === null ? "not known" : `${feed.ageS.toFixed(0)} s old`}. Trying again.</p>` : nothing}
    ${lapse(live)}
    ${alerts.view()}
    <div class="columns">
      <div>
        ${figures(feed)}
        <figure class="map-figure"><div id="map" class="map" role="region" aria-label="Map: the vehicle, its trail, and the planned place as a ring"></div>
          <svg id="drawing" hidden role="img" aria-label="Route, ranges and vehicle" preserveAspectRatio="xMidYMid meet"><title>Route and station ranges</title><desc></desc></svg>
          <figcaption>Dot: the vehicle. Ring: where the plan has it now. Dark line: the way flown while this page was open.</figcaption></figure>
        <figure><div class="scroll" tabindex="0" role="region" aria-label="Time-distance diagram"><svg id="time-distance" class="diagram" viewBox=${VIEW_BOX} role="img" aria-label="Distance along the path over time, planned and flown">
          ${path ? timeDistance(path, flown, live?.t_plus_s ?? null, live?.shift_s ?? 0) : nothing}</svg></div>
          <figcaption>Distance along the path over time: planned (thin), flown (bold); level lines are handovers.</figcaption></figure>
      </div>
      <div>
        ${result ? html`<section class="notice ${stateTone(result.outcome)}"><strong>${stateText(result.outcome)}</strong> ${result.reason ?? ""}
          <p>Handovers made: ${result.handovers ?? "–"}. <a href="v1/flights/${flight.id}/events">All events (JSON)</a></p></section>` : nothing}
        ${launch(all)} ${commands(all)} ${preflight(flight)}
      </div>
    </div>
    ${handovers(all)} ${links(all)}`;
}
