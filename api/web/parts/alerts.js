// Alerts by priority, as flight crews know them: warning (act now), caution (look soon), advisory (know it). Active ones
// are apart from past ones; one action acknowledges; a tone that can be turned off.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { tPlus } from "./templates.js";

const ACTIVE_S = 60;
const WARNING = /lapse|\bfalls?\b(?! behind)|descent|\blost\b|two vehicles|two autopilots|another station|somebody else|restarted|not heard|silent|battery|estimate|out of range|off the plan|failsafe/;
const ADVISORY = /re-?timed|was set|sent again|asked for again/;

/** The priority of an alarm by what it says. */
export function priorityOf(alarm) {
  const text = `${alarm.what ?? ""} ${alarm.reason ?? ""}`.toLowerCase();
  if (WARNING.test(text)) return "warning";
  if (ADVISORY.test(text)) return "advisory";
  return "caution";
}

const TITLE = { warning: "Warning", caution: "Caution", advisory: "Advisory" };
const ORDER = ["warning", "caution", "advisory"];
const keyOf = (alarm) => `${alarm.utc} ${alarm.what}`;

export class Alerts {
  /** The alerts of one flight; what was acknowledged is kept over a reload. */
  constructor(flightId, redraw) {
    this.redraw = redraw;
    this.store = `skyrelay.acknowledged.${flightId}`;
    this.acknowledged = new Set(JSON.parse(sessionStorage.getItem(this.store) ?? "[]"));
    this.sound = localStorage.getItem("skyrelay.sound") !== "off";
    this.known = null;
  }

  /** Take the alarms of a flight; a tone for what is new and not merely advisory. */
  take(alarms, nowUtc, ended) {
    this.all = alarms.map((a) => ({ ...a, key: keyOf(a), priority: priorityOf(a), age: (Date.parse(nowUtc) - Date.parse(a.utc)) / 1000 }));
    const keys = new Set(this.all.map((a) => a.key));
    const fresh = this.known && this.all.filter((a) => !this.known.has(a.key) && a.priority !== "advisory");
    this.known = keys;
    if (fresh?.length && this.sound && !ended) this.tone(fresh.some((a) => a.priority === "warning"));
    this.active = this.all.filter((a) => !this.acknowledged.has(a.key)).sort((a, b) => ORDER.indexOf(a.priority) - ORDER.indexOf(b.priority) || a.age - b.age);
    this.past = this.all.filter((a) => this.acknowledged.has(a.key)).reverse();
  }

  tone(urgent) {
    try {
      this.audio ??= new AudioContext();
      const { audio } = this;
      for (let k = 0; k < (urgent ? 3 : 1); k += 1) {
        const source = audio.createOscillator();
        const volume = audio.createGain();
        source.frequency.value = urgent ? 880 : 520;
        volume.gain.value = 0.08;
        source.connect(volume).connect(audio.destination);
        source.start(audio.currentTime + 0.25 * k);
        source.stop(audio.currentTime + 0.25 * k + 0.15);
      }
    } catch { /* a browser that makes no sound: the alert is seen and read */ }
  }

  acknowledge(keys) {
    for (const key of keys) this.acknowledged.add(key);
    sessionStorage.setItem(this.store, JSON.stringify([...this.acknowledged]));
    this.redraw();
  }

  toggleSound() {
    this.sound = !this.sound;
    localStorage.setItem("skyrelay.sound", this.sound ? "on" : "off");
    this.redraw();
  }

  line(a) {
    const details = Object.entries(a).filter(([k]) => !["utc", "t_plus_s", "what", "key", "priority", "age", "reason"].includes(k));
    return html`<strong>${TITLE[a.priority]}:</strong> ${a.what === "lapse" ? "lost C2 link" : a.what}${a.reason ? `: ${a.reason}` : ""}
      ${details.length ? html`<span class="soft">${details.map(([k, v]) => `${k.replaceAll("_", " ")} ${typeof v === "object" ? JSON.stringify(v) : v}`).join(", ")}</span>` : nothing}
      <time class="soft nowrap" datetime=${a.utc}>${a.t_plus_s === null ? a.utc?.slice(11, 19) : tPlus(a.t_plus_s)}</time>`;
  }

  view() {
    if (!this.all) return nothing;
    const spoken = this.active[0];
    return html`<section class="alerts" aria-labelledby="alerts-title">
      <h2 id="alerts-title">Alerts ${this.active.length ? html`<span class="count">${this.active.length} active</span>` : nothing}</h2>
      <p class="unseen" role="alert">${spoken ? `${TITLE[spoken.priority]}: ${spoken.what}` : ""}</p>
      ${this.active.length ? html`<ul class="alert-list" tabindex="0" aria-label="Active alerts">${this.active.map((a) => html`<li class="alert ${a.priority} ${a.age > ACTIVE_S ? "old" : ""}">${this.line(a)}
          <button type="button" @click=${() => this.acknowledge([a.key])}>Acknowledge</button></li>`)}</ul>
        ${this.active.length > 1 ? html`<p><button type="button" @click=${() => this.acknowledge(this.active.map((a) => a.key))}>Acknowledge all ${this.active.length}</button></p>` : nothing}`
      : html`<p class="status good">None active.</p>`}
      ${this.past.length ? html`<details><summary>${this.past.length} acknowledged</summary><ul class="past">${this.past.map((a) => html`<li>${this.line(a)}</li>`)}</ul></details>` : nothing}
      <label class="toggle"><input type="checkbox" .checked=${this.sound} @change=${() => this.toggleSound()}> Sound for warnings and cautions</label>
    </section>`;
  }
}
