// The OpenAPI document as a page to read.

import { ask, make, showProblem } from "./parts/format.js";

const METHODS = ["get", "post", "put", "patch", "delete"];

function resolve(document, schema) {
  if (!schema?.$ref) return schema;
  return schema.$ref.split("/").slice(1).reduce((node, part) => node?.[part], document);
}

function exampleOf(content) {
  if (content?.example !== undefined) return content.example;
  const first = Object.values(content?.examples || {})[0];
  return first?.value;
}

function typeOf(schema) {
  if (!schema) return "";
  if (schema.enum) return schema.enum.map((v) => JSON.stringify(v)).join(" | ");
  if (schema.const !== undefined) return JSON.stringify(schema.const);
  if (schema.anyOf) return schema.anyOf.map(typeOf).filter((t) => t !== "null").join(" | ");
  if (schema.$ref) return schema.$ref.split("/").pop();
  return schema.format ? `${schema.type} (${schema.format})` : String(schema.type ?? "");
}

function rows(pairs) {
  const table = make("table", {}, make("thead", {}, make("tr", {}, ...["Name", "Type", "Meaning"].map((t) => make("th", { scope: "col" }, t)))));
  const body = make("tbody");
  for (const [name, type, meaning] of pairs) {
    body.append(make("tr", {}, make("td", {}, make("code", {}, name)), make("td", {}, type), make("td", {}, meaning)));
  }
  table.append(body);
  return make("div", { class: "scroll" }, table);
}

function operation(document, path, method, op) {
  const box = make("details", { class: "op" }, make("summary", {}, make("code", { class: "method" }, method.toUpperCase()), make("code", {}, path), ` — ${op.summary || ""}`));
  if (op.description) box.append(make("p", {}, op.description));
  const parameters = (op.parameters || []).map((p) => resolve(document, p));
  if (parameters.length) {
    box.append(rows(parameters.map((p) => [p.name + (p.required ? " *" : ""), typeOf(p.schema), p.description || p.schema?.description || ""])));
  }
  const body = op.requestBody?.content?.["application/json"];
  if (body) {
    const schema = resolve(document, body.schema);
    const required = new Set(schema?.required || []);
    if (schema?.properties) {
      box.append(make("h4", {}, "Body"), rows(Object.entries(schema.properties).map(([name, s]) => [name + (required.has(name) ? " *" : ""), typeOf(s), s.description || ""])));
    }
    const example = exampleOf(body) ?? schema?.examples?.[0];
    if (example !== undefined) box.append(make("h4", {}, "Example"), make("pre", {}, JSON.stringify(example, null, 2)));
  }
  box.append(make("h4", {}, "Answers"), rows(Object.entries(op.responses || {}).map(([code, r]) => [code, Object.keys(r.content || {}).join(", "), r.description || ""])));
  return box;
}

const place = document.getElementById("reference");
try {
  const described = await ask("openapi.json");
  const groups = new Map((described.tags || []).map((t) => [t.name, { text: t.description || "", ops: [] }]));
  for (const [path, item] of Object.entries(described.paths)) {
    for (const method of METHODS.filter((m) => item[m])) {
      const tag = item[method].tags?.[0] || "other";
      if (!groups.has(tag)) groups.set(tag, { text: "", ops: [] });
      groups.get(tag).ops.push(operation(described, path, method, item[method]));
    }
  }
  place.replaceChildren(...[...groups].filter(([, g]) => g.ops.length).map(([name, g]) => make("section", {}, make("h2", {}, name), make("p", {}, g.text), ...g.ops)));
} catch (problem) {
  const box = make("div", { class: "notice" });
  place.replaceChildren(box);
  showProblem(box, problem);
}
