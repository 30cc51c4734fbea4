// Missions: what this is, all missions, and a form for one as JSON.

import { html, nothing, render } from "../vendor/lit-html/lit-html.js";
import { EXAMPLE } from "../parts/example.js";
import { ask, clock } from "../parts/format.js";
import { problemBox } from "../parts/templates.js";

const REFRESH_MS = 2000;
const PAGE = 25;

export async function open(host) {
  const state = { items: null, older: [], next: null, problem: null, sending: null, document: "" };

  const draw = () => render(view(state, actions), host);

  async function load() {
    try {
      const page = await ask(`v1/missions?limit=${PAGE}`);
      if (!state.older.length) state.next = page.next;
      state.items = [...page.items, ...state.older.filter((m) => !page.items.some((n) => n.id === m.id))];
      state.problem = null;
    } catch (problem) {
      state.problem = problem;
    }
    draw();
  }

  const actions = {
    async more() {
      const page = await ask(`v1/missions?limit=${PAGE}&cursor=${encodeURIComponent(state.next)}`);
      state.older = state.older.concat(page.items);
      state.next = page.next;
      await load();
    },
    async submit(event) {
      event.preventDefault();
      state.refused = null;
      state.sending = true;
      draw();
      try {
        const body = host.querySelector("#document").value;
        const mission = await ask("v1/missions", { method: "POST", headers: { "Content-Type": "application/json" }, body });
        location.hash = `#mission/${mission.id}`;
      } catch (problem) {
        state.refused = problem;
      }
      state.sending = false;
      draw();
    },
    async example() {
      const body = JSON.stringify(EXAMPLE);
      const mission = await ask("v1/missions", { method: "POST", headers: { "Content-Type": "application/json" }, body });
      location.hash = `#mission/${mission.id}`;
    },
    fill() {
      const box = host.querySelector("#document");
      box.value = JSON.stringify(EXAMPLE, null, 2);
      box.focus();
    },
  };

  draw();
  await load();
  const timer = setInterval(() => { if (!document.hidden) load(); }, REFRESH_MS);
  return { close: () => clearInterval(timer) };
}

const row = (m) => html`<tr>
  <td><a href="#mission/${m.id}">${m.name || m.id}</a></td>
  <td class="nowrap"><span class="status ${m.status}">${m.status}</span></td>
  <td class="number">${m.mission_time_s ? clock(m.mission_time_s) : "–"}</td>
  <td class="number">${m.handover_count ?? "–"}</td>
  <td class="nowrap"><time datetime=${m.created_utc}>${new Date(m.created_utc).toLocaleString()}</time></td></tr>`;

const intro = (actions) => html`<section class="intro" aria-labelledby="intro-title">
  <h2 id="intro-title">A flight beyond the range of any one station, relayed from station to station</h2>
  <svg viewBox="0 -30 640 220" role="img" aria-label="A path through three overlapping ranges; control changes hands where two of them overlap">
    <g class="intro-ranges"><circle cx="130" cy="80" r="105"></circle><circle cx="320" cy="70" r="105"></circle><circle cx="510" cy="80" r="105"></circle></g>
    <g class="intro-stations"><circle cx="130" cy="80" r="5"></circle><circle cx="320" cy="70" r="5"></circle><circle cx="510" cy="80" r="5"></circle></g>
    <path class="intro-path" d="M60 100 C 150 40, 250 60, 320 95 S 500 120, 580 60"></path>
    <g class="intro-handovers"><circle cx="226" cy="70" r="6"></circle><circle cx="415" cy="108" r="6"></circle></g>
    <text x="226" y="52" text-anchor="middle">handover</text><text x="415" y="92" text-anchor="middle">handover</text>
  </svg>
  <p>Each remote pilot station reaches so far. skyrelay chooses which station is in control when, plans the fastest path that
    never leaves their range, flies it, and hands control over where both stations reach the vehicle.</p>
  <p class="buttons"><button type="button" class="primary" @click=${actions.example}>Plan an example</button>
    <a class="button" href="#plan">Draw a mission on the map</a></p>
</section>`;

const view = (state, actions) => html`
  <h1>Missions</h1>
  ${problemBox(state.problem)}
  ${state.items?.length === 0 ? intro(actions) : nothing}
  ${state.items === null && !state.problem ? html`<p role="status">loading …</p>` : nothing}
  ${state.items?.length ? html`<div class="scroll" role="region" aria-label="Missions" tabindex="0">
    <table id="missions"><thead><tr><th scope="col">Mission</th><th scope="col">Status</th><th scope="col">Mission time</th>
      <th scope="col">Handovers</th><th scope="col">Added</th></tr></thead>
      <tbody>${state.items.map(row)}</tbody></table></div>
    ${state.next ? html`<p><button type="button" @click=${actions.more}>Show older missions</button></p>` : nothing}` : nothing}
  <section aria-labelledby="new-title">
    <h2 id="new-title">Plan a mission from JSON</h2>
    <form id="new" @submit=${actions.submit}>
      <label for="document">Mission, as JSON</label>
      <textarea id="document" rows="10" spellcheck="false" autocomplete="off" required aria-describedby="new-help"></textarea>
      <p id="new-help">Start, destination, stations with their ranges, limits. The <a href="docs">reference</a> has every field;
        <a href="#plan">the map</a> draws one.</p>
      <p class="buttons"><button type="submit" class="primary" ?disabled=${state.sending}>Plan it</button>
        <button type="button" id="example" @click=${actions.fill}>Fill in an example</button></p>
      ${problemBox(state.refused)}
    </form>
  </section>`;
