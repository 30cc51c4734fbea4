// Natural Earth's land for the map: 1:50 million for the whole world, 1:10 million in cells near what is looked at.

import { feature } from "../vendor/topojson-client/src/index.js";

const HERE = new URL("../vendor/", import.meta.url);
const FINE_ZOOM = 4.5;
const MOST_CELLS = 12;

let world = null;
let listing = null;
const cells = new Map();

const fetched = async (path) => (await fetch(new URL(path, HERE))).json();

/** Land of the whole world as GeoJSON. */
export async function coarse() {
  world ??= fetched("world-atlas/land-50m.json").then((topology) => feature(topology, topology.objects.land));
  return world;
}

/** Land of the cells in a view as GeoJSON; null where the view is too wide for it, or has none. */
export async function fine(bounds, zoom) {
  if (zoom < FINE_ZOOM) return null;
  listing ??= fetched("land-10m/cells.json").then((l) => ({ ...l, cells: new Set(l.cells) }));
  const { cell_deg: side, cells: known } = await listing;
  const names = [];
  for (let x = Math.floor(bounds.getWest() / side) * side; x <= bounds.getEast(); x += side) {
    for (let y = Math.floor(bounds.getSouth() / side) * side; y <= bounds.getNorth(); y += side) {
      const west = ((((x + 180) % 360) + 360) % 360) - 180;
      names.push({ name: `${west}_${y}`, shift: x - west });
    }
  }
  if (names.length > MOST_CELLS) return null;
  const land = await Promise.all(names.filter((n) => known.has(n.name)).map(async ({ name, shift }) => {
    if (!cells.has(name)) cells.set(name, fetched(`land-10m/${name}.json`));
    const shape = await cells.get(name);
    if (!shift) return { type: "Feature", properties: {}, geometry: shape };
    const moved = shape.coordinates.map((polygon) => polygon.map((ring) => ring.map(([x, y]) => [x + shift, y])));
    return { type: "Feature", properties: {}, geometry: { type: "MultiPolygon", coordinates: moved } };
  }));
  return { type: "FeatureCollection", features: land };
}
