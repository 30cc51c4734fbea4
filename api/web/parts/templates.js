// Pieces of HTML that several views show.

import { html, nothing } from "../vendor/lit-html/lit-html.js";
import { clock } from "./format.js";

/** A problem document (RFC 9457): what happened, each error with where, allowed and fix. */
export function problemBox(problem) {
  if (!problem) return nothing;
  const more = (e) => [
    e.value !== undefined && e.value !== null && e.value !== "" ? `is ${e.value}` : "",
    e.allowed ? `allowed: ${e.allowed}` : "", e.fix ?? "",
  ].filter(Boolean).join("; ");
  return html`<div class="notice bad" role="alert">
    <strong>${problem.title || "It did not work"}</strong>
    <p>${problem.detail ?? ""}</p>
    ${problem.errors?.length ? html`<ul>${problem.errors.map((e) => html`<li><code>${e.where}</code> ${e.what}${more(e) ? ` — ${more(e)}` : ""}</li>`)}</ul>` : nothing}
    ${problem.fix_text ? html`<p><strong>Smallest fix:</strong> ${problem.fix_text}</p>` : nothing}
  </div>`;
}

// States by the name the field has for them, where ours is shorter.
const STATE_TEXTS = { lapsed: "lost C2 link", contingency: "contingency procedure", landed: "landed by command" };
export const stateText = (state) => STATE_TEXTS[state] ?? state;

/** How a flight's state is to be taken: good, bad, wait. */
export function stateTone(state) {
  if (["completed", "landed", "cruise", "arrived"].includes(state)) return "good";
  if (["lapsed", "contingency", "lost", "refused"].includes(state)) return "bad";
  return "wait";
}

/** "T+ 4:10", or a dash. */
export const tPlus = (seconds) => (seconds === null || seconds === undefined ? "T+ –" : `T+ ${clock(seconds)}`);

/** Why the page cannot be drawn as it should, where it cannot. */
export const note = (text) => html`<p class="notice">${text}</p>`;
