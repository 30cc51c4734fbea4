// One remote pilot station's view of a flight, to be read at arm's length and on a phone: who has control, when it changes
// hands, what to do, and the answer.

import { html, nothing, render } from "../vendor/lit-html/lit-html.js";
import { clock } from "../parts/format.js";
import { FlightFeed } from "../parts/flight_feed.js";
import { problemBox, stateText, stateTone, tPlus } from "../parts/templates.js";

export async function open(host, { parts: [id, station] }) {
  const ui = { refused: null, sent: null };
  const feed = new FlightFeed(id, () => { if (!feed.closed) draw(); });

  const act = {
    async answer(index, word) {
      ui.refused = null;
      try {
        await feed.command(`handovers/${index}/${word}`, { by: station });
        ui.sent = { index, word };
      } catch (problem) {
        ui.refused = problem;
      }
      draw();
    },
  };

  const draw = () => render(view(feed, station, ui, act), host);
  await feed.begin();
  draw();
  const timer = setInterval(draw, 500);
  return { close() { clearInterval(timer); feed.close(); } };
}

/** This station's next handover: the receiving end first, then the transferring one. */
function upcoming(feed, station) {
  const { plan, live, flight } = feed;
  const done = (h) => ["confirmed", "released"].includes(flight.handover_states[h.index]);
  const times = new Map((live?.handovers ?? []).map((h) => [h.index, h.t_plus_s]));
  const left = plan.handovers.filter((h) => (h.to === station || h.from === station) && !done(h)
    && (live?.plan_s === null || live?.plan_s === undefined || h.time_s >= live.plan_s - 1));
  const next = left[0];
  return next ? { ...next, expected: times.get(next.index) ?? null, receiving: next.to === station } : null;
}

function countdown(feed, next) {
  const { live } = feed;
  if (live?.phase === "lapsed") return { text: "–", why: "Lost C2 link: no countdown." };
  const told = live?.next_handover;
  if (told?.index === next.index) return { text: clock(Math.max(0, told.in_s - (feed.ageS ?? 0))), why: "" };
  if (next.expected !== null && live?.t_plus_s !== null && live?.t_plus_s !== undefined && live.phase === "cruise") {
    return { text: clock(Math.max(0, next.expected - live.t_plus_s - (feed.ageS ?? 0))), why: "" };
  }
  return { text: live?.t_plus_s === null || live?.t_plus_s === undefined ? tPlus(next.time_s) : "–",
    why: live?.t_plus_s === null || live?.t_plus_s === undefined ? "Planned; the flight is not launched." : "The flight stands: no time can be given." };
}

const duties = (next, other) => (next.receiving ? {
  before: ["Link up, antenna on the vehicle, charts and weather at hand.", `Call ${other}: vehicle seen on your link, position and altitude agree.`, "Answer ready."],
  at: ["Accept. Control is yours when the screen says so, not before.", "Say: I have control."],
  after: ["Check speed, altitude and range left.", "Log the time and who handed over."],
} : {
  before: [`Call ${other}: is the vehicle seen there? Position and altitude agree?`, "Keep transmitting until control is confirmed away."],
  at: ["Say: you have control. Wait for: I have control.", "Keep the link up until the overlap ends."],
  after: ["Stay ready to take it back while both stations cover the vehicle.", "Log the time and who took over."],
});

function view(feed, station, ui, act) {
  const { flight, plan, live } = feed;
  const mine = live?.station === station && !feed.ended;
  const next = feed.ended ? null : upcoming(feed, station);
  const about = plan.mission.stations.find((s) => s.id === station);
  const silent = !feed.ended && !feed.connected;
  if (!about) return html`<h1>${station}</h1><p class="notice bad">This flight's mission has no station ${station}.</p>`;
  const otherId = next && (next.receiving ? next.from : next.to);
  const other = next && plan.mission.stations.find((s) => s.id === otherId);
  const count = next && countdown(feed, next);
  const list = next && duties(next, otherId);
  return html`
    <p><a href="#flight/${feed.id}">← the flight</a></p>
    <h1>${about.name || station}</h1>
    ${silent ? html`<p class="notice bad" role="alert"><strong>No live data</strong> for ${feed.ageS === null ? "some time" : `${feed.ageS.toFixed(0)} s`}. Trying again.</p>` : nothing}
    <p class="control ${mine ? "mine" : ""}" role="status">${mine ? "You have control" : feed.ended ? `Flight ended: ${stateText(flight.result?.outcome ?? flight.phase)}` : live?.station ? html`<b>${live.station}</b> has control` : "Nobody has control yet"}
      <span class="status ${stateTone(live?.phase ?? flight.phase)}">${stateText(live?.phase ?? flight.phase)}</span></p>
    ${next ? html`
      <section class="next" aria-labelledby="next-title">
        <h2 id="next-title">${next.receiving ? "You take control" : `You hand over to ${otherId}`}</h2>
        <p class="countdown" role="timer">${count.text}</p>
        ${count.why ? html`<p>${count.why}</p>` : nothing}
        <p>Handover ${next.index}, planned ${tPlus(next.time_s)}; possible ${tPlus(next.overlap.start_s)} to ${tPlus(next.overlap.end_s)}.
          Range left then: ${(next.receiving ? next.margin.to_m : next.margin.from_m).toFixed(0)} m.
          State: <b>${flight.handover_states[next.index] ?? "to come"}</b>.</p>
        ${next.receiving ? html`<div class="answers">
            <button type="button" class="primary" @click=${() => act.answer(next.index, "ready")}>Ready</button>
            <button type="button" class="primary" @click=${() => act.answer(next.index, "accept")}>Accept</button>
            <button type="button" @click=${() => act.answer(next.index, "refuse")}>Refuse</button></div>` : nothing}
        ${ui.sent?.index === next.index ? html`<p role="status" class="status good">Answered: ${ui.sent.word}.</p>` : nothing}
        ${problemBox(ui.refused)}
        <dl class="pairs"><div><dt>${otherId}</dt><dd>${other?.contact ?? "no contact given"}</dd></div>
          <div><dt>Channel</dt><dd>${about.radio_channel ?? other?.radio_channel ?? "none given"}</dd></div></dl>
        ${Object.entries({ Before: list.before, "At the handover": list.at, After: list.after }).map(([title, items]) => html`<h3>${title}</h3><ul>${items.map((i) => html`<li>${i}</li>`)}</ul>`)}
        <h3>If it fails</h3><p>Control stays with ${next.from}. The vehicle stops before its range ends, waits, and then flies the contingency procedure.</p>
      </section>` : html`<p>No handover of this station is to come.</p>`}
    <p><a class="button" href="v1/missions/${flight.mission_id}/handovers?format=html&station=${encodeURIComponent(station)}">Sheet to print</a></p>`;
}
