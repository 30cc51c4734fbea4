// Numbers and nodes as the pages show them.

/** Seconds as h:mm:ss (or m:ss). */
export function clock(seconds) {
  const s = Math.round(seconds);
  const two = (n) => String(n).padStart(2, "0");
  const hours = Math.floor(s / 3600);
  const minutes = Math.floor((s % 3600) / 60);
  return hours ? `${hours}:${two(minutes)}:${two(s % 60)}` : `${minutes}:${two(s % 60)}`;
}

/** Metres as a person reads them. */
export function metres(value) {
  return value >= 10000 ? `${(value / 1000).toFixed(1)} km` : `${Math.round(value)} m`;
}

export function degrees(place) {
  return place.lat_deg === undefined
    ? `${place.east_m.toFixed(0)} E, ${place.north_m.toFixed(0)} N (m)`
    : `${place.lat_deg.toFixed(5)}, ${place.lon_deg.toFixed(5)}`;
}

/** An element with attributes and children; text is always text, never markup. */
export function make(tag, attributes = {}, ...children) {
  const node = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== undefined && value !== null) node.setAttribute(name, value);
  }
  node.append(...children.filter((c) => c !== undefined && c !== null));
  return node;
}

export function makeSvg(tag, attributes = {}, ...children) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) node.setAttribute(name, value);
  node.append(...children);
  return node;
}

/** Fill `box` with a problem document (RFC 9457): what happened, and each error with where, allowed and fix. */
export function showProblem(box, problem) {
  box.replaceChildren();
  box.hidden = !problem;
  if (!problem) return;
  box.classList.add("bad");
  box.append(make("strong", {}, problem.title || "It did not work"), make("p", {}, problem.detail || ""));
  const list = make("ul");
  for (const error of problem.errors || []) {
    const more = [];
    if (error.value !== undefined && error.value !== null && error.value !== "") more.push(`is ${error.value}`);
    if (error.allowed) more.push(`allowed: ${error.allowed}`);
    if (error.fix) more.push(error.fix);
    list.append(make("li", {}, make("code", {}, error.where), ` ${error.what}${more.length ? " — " + more.join("; ") : ""}`));
  }
  if (list.children.length) box.append(list);
  if (problem.fix_text) box.append(make("p", {}, make("strong", {}, "Smallest fix: "), problem.fix_text));
}

/** Ask the service; a problem document is thrown as it is. */
export async function ask(path, options = {}) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw { title: "The service does not answer", detail: "It may have been stopped. This page tries again by itself.", errors: [] };
  }
  const body = (answer.headers.get("content-type") || "").includes("json") ? await answer.json() : await answer.text();
  if (!answer.ok) throw typeof body === "string" ? { title: `Error ${answer.status}`, detail: body, errors: [] } : body;
  return body;
}
