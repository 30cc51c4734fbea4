// The page's frame: which view is shown (by the address), whether the service answers, the clock. Everything comes from
// the same API programs use.

import { ask } from "./parts/format.js";

const REFRESH_MS = 3000;
const main = document.getElementById("main");

// By the first word of the address; a view's module is loaded when it is first shown.
const VIEWS = {
  operations: () => import("./views/operations.js"),
  missions: () => import("./views/missions.js"),
  mission: () => import("./views/mission.js"),
  plan: () => import("./views/plan.js"),
  flight: () => import("./views/flight.js"),
  station: () => import("./views/station.js"),
};
const FIRST = "missions";

let shown = null;
let turn = 0;

/** `#mission/ID/more?t=12` as `{ view, parts, query }`. */
function address() {
  const [path, query] = location.hash.slice(1).split("?");
  const [view, ...parts] = path.split("/").map(decodeURIComponent);
  return { view: VIEWS[view] ? view : FIRST, parts, query: new URLSearchParams(query) };
}

async function show() {
  if (location.hash === "#main") return;
  const mine = (turn += 1);
  const at = address();
  shown?.close();
  shown = null;
  document.querySelectorAll("header nav a").forEach((a) => {
    const here = a.getAttribute("href") === `#${at.view}`;
    if (here) a.setAttribute("aria-current", "page");
    else a.removeAttribute("aria-current");
  });
  const host = document.createElement("div");
  host.className = `view view-${at.view}`;
  main.replaceChildren(host);
  try {
    const { open } = await VIEWS[at.view]();
    const made = await open(host, at);
    if (mine === turn) shown = made;
    else made.close();
  } catch (fault) {
    if (mine !== turn) return;
    const { render } = await import("./vendor/lit-html/lit-html.js");
    const { problemBox } = await import("./parts/templates.js");
    render(problemBox(fault instanceof Error ? { title: "This page has a fault", detail: fault.message } : fault), host);
  }
  const heading = host.querySelector("h1");
  document.title = heading ? `skyrelay: ${heading.textContent.trim()}` : "skyrelay";
  if (turn > 1 && heading) {
    heading.tabIndex = -1;
    heading.focus({ preventScroll: true });
  }
}

async function service() {
  const box = document.getElementById("service");
  let state;
  try {
    await ask("readyz");
    state = ["status good", "ready"];
  } catch (problem) {
    state = ["status bad", problem.detail || "The service is not ready."];
  }
  if (box.textContent !== state[1]) [box.className, box.textContent] = state;
}

function clock() {
  document.getElementById("utc").textContent = new Date().toISOString().slice(11, 19);
}

window.addEventListener("hashchange", show);
clock();
setInterval(clock, 1000);
setInterval(() => { if (!document.hidden) service(); }, REFRESH_MS);
await Promise.all([service(), show()]);
