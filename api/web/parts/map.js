// The map: MapLibre GL over Natural Earth's land, all of it from this service. Labels are nodes of the page, so no
// glyphs are needed. Where there is no WebGL, `supported` is false and the drawing in the plan's plane serves.

import { coarse, fine } from "./coast.js";
import { colourOf } from "./drawing.js";
import { circle, onGlobe, placeAt, sample } from "./geometry.js";
import { make } from "./format.js";

const VENDOR = new URL("../vendor/", import.meta.url);
const EMPTY = { type: "FeatureCollection", features: [] };
const PALETTE = {
  light: { water: "#dfe8f1", land: "#f7f6f1", coast: "#9aa7b5", ink: "#1a202c", soft: "#5a6778", ghost: "#4a5568" },
  dark: { water: "#0d131c", land: "#1d2530", coast: "#55637a", ink: "#e6ebf2", soft: "#9aa7b8", ghost: "#a9b4c4" },
};
const dark = window.matchMedia("(prefers-color-scheme: dark)");

let library = null;

async function maplibre() {
  library ??= import("../vendor/maplibre-gl/dist/maplibre-gl.mjs").then((module) => {
    module.setWorkerUrl(new URL("maplibre-gl/dist/maplibre-gl-worker.mjs", VENDOR).href);
    return module;
  });
  return library;
}

/** Whether this browser can draw the map. */
export function supported() {
  const canvas = document.createElement("canvas");
  return Boolean(canvas.getContext("webgl2"));
}

const featureOf = (geometry, properties = {}) => ({ type: "Feature", properties, geometry });
const collection = (features) => ({ type: "FeatureCollection", features });

function style(colours) {
  const source = { type: "geojson", data: EMPTY };
  const line = (id, paint, more = {}) => ({ id, type: "line", source: id, paint, layout: { "line-cap": "round", "line-join": "round" }, ...more });
  return {
    version: 8,
    sources: Object.fromEntries(["land", "coast", "ranges", "keepouts", "gap", "proposal", "route", "trail", "ghost", "vehicle", "stations", "handovers"].map((id) => [id, { ...source }])),
    layers: [
      { id: "water", type: "background", paint: { "background-color": colours.water } },
      { id: "land", type: "fill", source: "land", paint: { "fill-color": colours.land, "fill-outline-color": colours.coast } },
      { id: "coast", type: "fill", source: "coast", paint: { "fill-color": colours.land, "fill-outline-color": colours.coast } },
      { id: "ranges", type: "fill", source: "ranges", paint: { "fill-color": ["get", "colour"], "fill-opacity": ["get", "opacity"] } },
      line("ranges-edge", { "line-color": ["get", "colour"], "line-width": 1.4, "line-opacity": 0.8 }, { source: "ranges" }),
      { id: "keepouts", type: "fill", source: "keepouts", paint: { "fill-color": "#a32626", "fill-opacity": 0.25 } },
      line("gap", { "line-color": "#c22f2f", "line-width": 4, "line-dasharray": [1, 2] }),
      line("route-casing", { "line-color": colours.land, "line-width": 6 }, { source: "route" }),
      line("route", { "line-color": ["get", "colour"], "line-width": 3.5 }),
      line("proposal", { "line-color": colours.ink, "line-width": 3, "line-dasharray": [2, 2] }),
      line("trail", { "line-color": colours.ink, "line-width": 2 }),
      { id: "stations", type: "circle", source: "stations", paint: { "circle-radius": 5, "circle-color": ["get", "colour"], "circle-stroke-color": colours.land, "circle-stroke-width": 1.5 } },
      { id: "handovers", type: "circle", source: "handovers", paint: { "circle-radius": 4, "circle-color": colours.land, "circle-stroke-color": colours.ink, "circle-stroke-width": 2 } },
      { id: "ghost", type: "circle", source: "ghost", paint: { "circle-radius": 7, "circle-color": "rgba(0,0,0,0)", "circle-stroke-color": colours.ghost, "circle-stroke-width": 2 } },
      { id: "vehicle", type: "circle", source: "vehicle", paint: { "circle-radius": 7, "circle-color": colours.ink, "circle-stroke-color": colours.land, "circle-stroke-width": 2 } },
    ],
  };
}

export class MissionMap {
  /** A map in `box`; `await ready` before it is drawn on. */
  constructor(box) {
    this.box = box;
    this.labels = [];
    this.data = new Map();
    this.trail = [];
    this.ready = this.begin();
  }

  async begin() {
    this.gl = await maplibre();
    const colours = () => PALETTE[dark.matches ? "dark" : "light"];
    this.map = new this.gl.Map({
      container: this.box, style: style(colours()), attributionControl: false, fadeDuration: 0, renderWorldCopies: true,
      center: [0, 20], zoom: 1, dragRotate: false, pitchWithRotate: false, maxPitch: 0,
    });
    this.map.touchZoomRotate.disableRotation();
    this.map.addControl(new this.gl.NavigationControl({ showCompass: false }), "top-right");
    this.map.addControl(new this.gl.ScaleControl({ unit: "metric" }), "bottom-left");
    await new Promise((resolve) => { this.map.once("load", resolve); });
    this.set("land", await coarse());
    const nearer = async () => {
      const land = await fine(this.map.getBounds(), this.map.getZoom());
      if (land) this.set("coast", land);
    };
    this.map.on("moveend", nearer);
    this.onScheme = () => {
      this.map.setStyle(style(colours()));
      this.map.once("styledata", () => { for (const [id, data] of this.data) this.map.getSource(id)?.setData(data); });
    };
    dark.addEventListener("change", this.onScheme);
    await nearer();
    return this;
  }

  set(id, data) {
    this.data.set(id, data);
    this.map.getSource(id)?.setData(data);
  }

  /** A label that stands beside a place; text is always text. */
  label(lonLat, text, kind) {
    const marker = new this.gl.Marker({ element: make("span", { class: `map-label ${kind}` }, text), anchor: "left", offset: [8, 0] });
    this.labels.push(marker.setLngLat(lonLat).addTo(this.map));
  }

  clear() {
    for (const marker of this.labels) marker.remove();
    this.labels = [];
    this.trail = [];
    for (const id of this.data.keys()) if (id !== "land" && id !== "coast") this.set(id, EMPTY);
  }

  /** Draw a mission's stations and ends; `used` are the stations flown, in order. */
  drawMission(mission, used = mission.stations.map((s) => s.id), { fit = true } = {}) {
    this.clear();
    const colour = (id) => (used.includes(id) ? colourOf(used.indexOf(id)) : PALETTE[dark.matches ? "dark" : "light"].soft);
    const place = (p) => [p.lon_deg, p.lat_deg];
    this.set("ranges", collection(mission.stations.map((s) => featureOf(
      { type: "Polygon", coordinates: [circle(s.lon_deg, s.lat_deg, s.range_m)] },
      { colour: colour(s.id), opacity: used.includes(s.id) ? 0.1 : 0.03, id: s.id },
    ))));
    this.set("stations", collection(mission.stations.map((s) => featureOf({ type: "Point", coordinates: place(s) }, { colour: colour(s.id), id: s.id }))));
    if (mission.stations.length <= 40) {
      for (const s of mission.stations) this.label(place(s), s.id, used.includes(s.id) ? "station" : "station unused");
    }
    this.label(place(mission.start), "start", "end");
    this.label(place(mission.destination), "destination", "end");
    const points = [place(mission.start), place(mission.destination), ...mission.stations.filter((s) => used.includes(s.id))
      .flatMap((s) => circle(s.lon_deg, s.lat_deg, s.range_m, 8))];
    if (fit) this.fit(points);
  }

  fit(points) {
    const box = points.reduce((b, p) => b.extend(p), new this.gl.LngLatBounds(points[0], points[0]));
    this.map.fitBounds(box, { padding: 30, animate: false, maxZoom: 14 });
  }

  /** Draw a plan: mission, route coloured by the station in control, handovers. */
  drawPlan(plan, { fit = true } = {}) {
    this.plan = plan;
    this.drawMission(plan.mission, plan.stations, { fit });
    const routes = [];
    for (const point of sample(plan, 800)) {
      const lonLat = onGlobe(plan, point.at[0], point.at[1]);
      const last = routes[routes.length - 1];
      if (last && last.station === point.station) last.line.push(lonLat);
      else routes.push({ station: point.station, line: last ? [last.line[last.line.length - 1], lonLat] : [lonLat] });
    }
    this.set("route", collection(routes.map((r) => featureOf({ type: "LineString", coordinates: r.line }, { colour: colourOf(plan.stations.indexOf(r.station)) }))));
    this.set("handovers", collection(plan.handovers.map((h) => featureOf({ type: "Point", coordinates: [h.position.lon_deg, h.position.lat_deg] }, { index: h.index }))));
  }

  /** A handle that can be dragged, and moved by the arrow keys; `moved` is told where it was put. */
  handle(lonLat, text, kind, moved) {
    const element = make("button", { type: "button", class: `handle ${kind}`, "aria-label": `${text}: drag, or move with the arrow keys`, title: text });
    const marker = new this.gl.Marker({ element, draggable: true }).setLngLat(lonLat).addTo(this.map);
    marker.on("dragend", () => moved(marker.getLngLat()));
    const steps = { ArrowUp: [0, -1], ArrowDown: [0, 1], ArrowLeft: [-1, 0], ArrowRight: [1, 0] };
    element.addEventListener("keydown", (event) => {
      const step = steps[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      const at = this.map.project(marker.getLngLat());
      const size = event.shiftKey ? 20 : 4;
      moved(this.map.unproject([at.x + size * step[0], at.y + size * step[1]]));
    });
    return marker;
  }

  /** Where coverage has a gap: a place and its size (null: none). */
  gap(trouble) {
    const ring = trouble && circle(trouble.place.lon_deg, trouble.place.lat_deg, Math.max(trouble.gap_m ?? 0, 500) / 2);
    this.set("gap", trouble ? collection([featureOf({ type: "LineString", coordinates: ring })]) : EMPTY);
  }

  /** A plan beside the one drawn, dashed (null: none). */
  propose(plan) {
    const line = plan && sample(plan, 600).map((s) => onGlobe(plan, s.at[0], s.at[1]));
    this.set("proposal", plan ? collection([featureOf({ type: "LineString", coordinates: line })]) : EMPTY);
  }

  /** The planned place at a time of the plan (null: nowhere). */
  ghost(time) {
    if (time === null || !this.plan) return this.set("ghost", EMPTY);
    const [east, north] = placeAt(this.plan, time);
    return this.set("ghost", collection([featureOf({ type: "Point", coordinates: onGlobe(this.plan, east, north) })]));
  }

  /** The vehicle, and the way it came. */
  vehicle(place) {
    if (!place) return this.set("vehicle", EMPTY);
    const lonLat = [place.lon_deg, place.lat_deg];
    const last = this.trail[this.trail.length - 1];
    if (!last || last[0] !== lonLat[0] || last[1] !== lonLat[1]) this.trail.push(lonLat);
    if (this.trail.length > 20000) this.trail = this.trail.filter((_, i) => i % 2 === 0);
    this.set("trail", collection(this.trail.length > 1 ? [featureOf({ type: "LineString", coordinates: this.trail })] : []));
    return this.set("vehicle", collection([featureOf({ type: "Point", coordinates: lonLat })]));
  }

  remove() {
    dark.removeEventListener("change", this.onScheme);
    this.map?.remove();
  }
}
