// The first page: missions, one mission, a form. Everything comes from the same API programs use.

import { ask, clock, degrees, make, metres, showProblem } from "./format.js";
import { drawBars, drawMap, drawVehicle, markNow } from "./drawing.js";

const $ = (id) => document.getElementById(id);
const WORKING = new Set(["queued", "planning"]);
const REFRESH_MS = 2000;

const EXAMPLE = {
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

// States by the name the field has for them, where ours is shorter.
const STATE_TEXTS = { lapsed: "lost C2 link", contingency: "contingency procedure", landed: "landed by command" };
const stateText = (state) => STATE_TEXTS[state] ?? state;

let older = [];
let next = null;
let shown = null; // { id, plan, unit, status }
let telemetry = null;

async function service() {
  const box = $("service");
  try {
    await ask("readyz");
    box.className = "status good";
    box.textContent = "The service is ready.";
  } catch (problem) {
    box.className = "status bad";
    box.textContent = problem.detail || "The service is not ready.";
  }
}

function missionRow(mission) {
  const added = new Date(mission.created_utc);
  return make("tr", {},
    make("td", {}, make("a", { href: `#mission/${mission.id}` }, mission.name || mission.id)),
    make("td", { class: "nowrap" }, make("span", { class: `status ${mission.status}` }, mission.status)),
    make("td", { class: "number" }, mission.mission_time_s ? clock(mission.mission_time_s) : "–"),
    make("td", { class: "number" }, mission.handover_count ?? "–"),
    make("td", { class: "nowrap" }, make("time", { datetime: mission.created_utc }, added.toLocaleString())));
}

async function missions() {
  const page = await ask("v1/missions?limit=25");
  if (!older.length) next = page.next;
  const rows = [...page.items, ...older.filter((m) => !page.items.some((n) => n.id === m.id))];
  $("missions").hidden = rows.length === 0;
  $("missions-empty").hidden = rows.length > 0;
  $("missions").tBodies[0].replaceChildren(...rows.map(missionRow));
  $("more").hidden = !next;
}

$("more").addEventListener("click", async () => {
  const page = await ask(`v1/missions?limit=25&cursor=${encodeURIComponent(next)}`);
  older = older.concat(page.items);
  next = page.next;
  await missions();
});

function figures(plan) {
  const gap = (100 * (plan.mission_time_s - plan.lower_bound_s)) / plan.mission_time_s;
  const rows = [
    ["Mission time", `${clock(plan.mission_time_s)} (${plan.mission_time_s.toFixed(1)} s)`],
    ["Path", metres(plan.path_length_m)],
    ["Nothing can be faster than", `${clock(plan.lower_bound_s)} (${gap.toFixed(1)} % less)`],
    ["Stations in flight order", plan.stations.length],
    ["Certificate", plan.certificate.feasible ? "every limit holds on the whole curve" : "NOT feasible"],
    ["Planned in", `${plan.solve_time_s.toFixed(2)} s`],
  ];
  $("figures").replaceChildren(...rows.map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, String(value)))));
}

function handovers(plan) {
  const rows = plan.handovers.map((h) => make("tr", {},
    make("td", {}, String(h.index)),
    make("td", { class: "nowrap", title: `${h.time_s.toFixed(1)} s` }, clock(h.time_s)),
    make("td", {}, h.from), make("td", {}, h.to),
    make("td", { class: "nowrap" }, degrees(h.position)),
    make("td", { class: "number" }, (h.position.alt_amsl_m ?? h.position.up_m).toFixed(0)),
    make("td", { class: "nowrap" }, `${clock(h.overlap.start_s)} to ${clock(h.overlap.end_s)}`),
    make("td", { class: "number" }, `${h.margin.from_m.toFixed(0)} / ${h.margin.to_m.toFixed(0)}`)));
  if (!rows.length) rows.push(make("tr", {}, make("td", { colspan: 8 }, "None: one station covers the whole flight.")));
  $("handovers").tBodies[0].replaceChildren(...rows);
}

function downloads(mission) {
  const base = `v1/missions/${mission.id}`;
  const offers = [["Plan (JSON)", `${base}/plan`], ...(mission.formats?.handovers || []).map((f) => [`Handovers (${f})`, `${base}/handovers?format=${f}`]),
    ...(mission.formats?.setpoints || []).map((f) => [`Setpoints at 20 Hz (${f})`, `${base}/setpoints?rate=20&format=${f}`]),
    ...(mission.formats?.export || []).map((f) => [`Export (${f})`, `${base}/export?format=${f}`])];
  $("downloads").replaceChildren(...offers.map(([text, href]) => make("li", {}, make("a", { href }, text))));
}

async function detail(id) {
  const mission = await ask(`v1/missions/${id}`);
  $("detail-title").textContent = mission.name || mission.id;
  const line = $("detail-status");
  line.className = `status ${mission.status}`;
  const done = mission.progress?.phase && WORKING.has(mission.status) ? `: ${mission.progress.phase}` : "";
  const text = `${mission.status}${done}`;
  if (line.textContent !== text) line.textContent = text;
  showProblem($("problem"), mission.problem ? { title: mission.problem.title, detail: mission.problem.detail, errors: mission.problem.errors, fix_text: mission.problem.fix_text } : null);
  $("planned").hidden = mission.status !== "planned";
  if (mission.status === "planned" && (shown.plan?.plan_sha256 !== mission.plan_sha256)) {
    const plan = await ask(`v1/missions/${id}/plan`);
    if (shown?.id !== id) return;
    shown.plan = plan;
    figures(plan);
    handovers(plan);
    drawBars($("bars"), plan);
    shown.unit = drawMap($("map"), $("map-caption"), plan).unit;
    downloads(mission);
  }
  shown.status = mission.status;
  if (mission.status === "planned") await flight(id);
}

async function flight(id) {
  let page;
  try {
    page = await ask(`v1/flights?mission_id=${id}&limit=1`);
  } catch {
    return;
  }
  const latest = page.items[0];
  $("flight").hidden = !latest;
  if (!latest || telemetry?.id === latest.id) return;
  telemetry?.socket.close();
  const address = new URL(`v1/flights/${latest.id}/telemetry`, document.baseURI);
  address.protocol = address.protocol.replace("http", "ws");
  telemetry = { id: latest.id, socket: new WebSocket(address) };
  telemetry.socket.addEventListener("message", (message) => live(JSON.parse(message.data)));
}

function live(state) {
  if (!shown?.plan) return;
  const plan = shown.plan;
  const time = state.t_plus_s ?? null;
  const parts = [stateText(state.state)];
  if (time !== null) parts.push(`T+ ${clock(time)} of ${clock(plan.mission_time_s)}`);
  if (state.station) parts.push(`${state.station} in control`);
  if (state.speed_m_s !== undefined && state.speed_m_s !== null) parts.push(`${state.speed_m_s.toFixed(1)} m/s`);
  $("flight-now").textContent = parts.join(" · ");
  $("flight-now").className = `status ${["completed", "landed"].includes(state.outcome) ? "good" : state.outcome ? "bad" : "wait"}`;
  // Spoken by screen readers: only what matters, not every second.
  const said = `${stateText(state.outcome || state.state)}${state.station ? `, ${state.station} in control` : ""}`;
  if ($("flight-say").textContent !== said) $("flight-say").textContent = said;
  const upcoming = state.next_handover;
  $("flight-next").textContent = upcoming ? `Receiving station ${upcoming.to} takes control in ${clock(Math.max(0, upcoming.in_s))}.` : "";
  drawVehicle($("map"), plan, shown.unit, state.position);
  markNow($("bars"), plan, time);
}

async function route() {
  const match = /^#mission\/([\w-]+)$/.exec(location.hash);
  telemetry?.socket.close();
  telemetry = null;
  $("home").hidden = Boolean(match);
  $("detail").hidden = !match;
  shown = match ? { id: match[1] } : null;
  document.title = "skyrelay: missions";
  await refresh();
  if (match) {
    document.title = `skyrelay: ${$("detail-title").textContent}`;
    $("detail-title").focus();
  }
}

async function refresh() {
  await service();
  try {
    if (shown) await detail(shown.id);
    else await missions();
  } catch (problem) {
    if (shown) {
      $("planned").hidden = true;
      showProblem($("problem"), problem instanceof Error ? { title: "This page has a fault", detail: problem.message } : problem);
    }
  }
}

$("new").addEventListener("submit", async (event) => {
  event.preventDefault();
  const button = $("new").querySelector("[type=submit]");
  button.disabled = true;
  showProblem($("new-problem"), null);
  try {
    const mission = await ask("v1/missions", {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: $("document").value,
    });
    location.hash = `#mission/${mission.id}`;
  } catch (problem) {
    showProblem($("new-problem"), problem);
  } finally {
    button.disabled = false;
  }
});

$("example").addEventListener("click", () => {
  $("document").value = JSON.stringify(EXAMPLE, null, 2);
  $("document").focus();
});

document.querySelectorAll(".here").forEach((node) => { node.textContent = document.baseURI.replace(/[#?].*$/, ""); });
window.addEventListener("hashchange", route);
window.addEventListener("resize", () => {
  if (shown?.plan) shown.unit = drawMap($("map"), $("map-caption"), shown.plan).unit;
});
await route();
setInterval(() => { if (!document.hidden) refresh(); }, REFRESH_MS);
