// Profiles along a plan: altitude, speed, acceleration and range left, with their limits; one cursor for all.

import uPlot from "../vendor/uplot/dist/uPlot.esm.js";
import { clock, make } from "./format.js";
import { sample } from "./geometry.js";

const HEIGHT = 132;
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** The charts of a plan: what each shows, its limits, and the figure at a sample. */
function charts(plan) {
  const { limits } = plan.mission;
  const floor = limits.min_alt_amsl_m ?? limits.min_up_m;
  const ceiling = limits.max_alt_amsl_m ?? limits.max_up_m;
  const up0 = limits.min_alt_amsl_m !== undefined ? plan.origin.alt_amsl_m : 0;
  return [
    { title: "Altitude", unit: limits.min_alt_amsl_m !== undefined ? "m AMSL" : "m above the origin", of: (s) => s.at[2] + up0, limits: [floor, ceiling] },
    { title: "Speed", unit: "m/s", of: (s) => s.speed, limits: [limits.max_speed_m_s] },
    { title: "Acceleration", unit: "m/s²", of: (s) => s.acceleration, limits: [limits.max_accel_m_s2] },
    { title: "Range left to the station in control", unit: "m", of: (s) => s.margin, limits: [plan.mission.options?.range_margin_m ?? 0] },
  ];
}

/**
 * Draw the profiles of a plan into `box`. `onTime` is told the time under the cursor, in s of the plan, or null.
 * Returns `{ mark(time), resize(), remove() }`; `mark` shows where the flight stands.
 */
export function drawProfiles(box, plan, onTime) {
  const samples = sample(plan, 900);
  const times = samples.map((s) => s.time);
  const handovers = plan.handovers.map((h) => h.time_s);
  let now = null;
  const marks = (u) => {
    const { ctx } = u;
    const line = (time, stroke, dash, width) => {
      const x = Math.round(u.valToPos(time, "x", true));
      ctx.save();
      ctx.strokeStyle = stroke;
      ctx.lineWidth = width * devicePixelRatio;
      ctx.setLineDash(dash);
      ctx.beginPath();
      ctx.moveTo(x, u.bbox.top);
      ctx.lineTo(x, u.bbox.top + u.bbox.height);
      ctx.stroke();
      ctx.restore();
    };
    for (const time of handovers) line(time, colour("--soft"), [3, 4], 1);
    if (now !== null) line(now, colour("--ink"), [], 2);
  };
  const made = charts(plan).map((chart) => {
    const values = samples.map(chart.of);
    const limits = chart.limits.filter((v) => v !== undefined && v !== null);
    const figure = make("figure", { class: "profile" });
    const readout = make("output", {}, "");
    figure.append(make("figcaption", {}, make("b", {}, chart.title), ` ${chart.unit} `, readout));
    box.append(figure);
    const axis = { stroke: () => colour("--soft"), grid: { stroke: () => colour("--line"), width: 0.5 }, ticks: { stroke: () => colour("--line"), width: 0.5 }, font: "12px system-ui, sans-serif" };
    const low = Math.min(...values, ...limits);
    const high = Math.max(...values, ...limits);
    const room = Math.max(1e-3, 0.08 * (high - low));
    return { chart, readout, plot: new uPlot({
      width: Math.max(260, figure.clientWidth), height: HEIGHT, legend: { show: false },
      cursor: { sync: { key: plan.plan_sha256 ?? "plan" }, drag: { x: false, y: false }, y: false },
      scales: { x: { time: false, range: [0, plan.mission_time_s] }, y: { range: [low - room, high + room] } },
      axes: [{ ...axis, values: (_, ticks) => ticks.map((t) => clock(t)), space: 70 }, { ...axis, size: 58 }],
      series: [{}, { stroke: () => colour("--accent"), width: 2, points: { show: false } },
        ...limits.map(() => ({ stroke: () => colour("--bad"), width: 1, dash: [6, 4], points: { show: false } }))],
      hooks: {
        draw: [marks],
        setCursor: [(u) => {
          const index = u.cursor.idx;
          readout.textContent = index === null || index === undefined ? "" : `${values[index].toFixed(1)} at T+ ${clock(times[index])}`;
          if (u === made[0].plot) onTime(index === null || index === undefined ? null : times[index]);
        }],
      },
    }, [times, values, ...limits.map((limit) => times.map(() => limit))], figure) };
  });
  const resize = () => { for (const { plot } of made) plot.setSize({ width: Math.max(260, plot.root.parentElement.clientWidth), height: HEIGHT }); };
  window.addEventListener("resize", resize);
  return {
    mark(time) {
      now = time;
      for (const { plot } of made) plot.redraw(false);
    },
    resize,
    remove() {
      window.removeEventListener("resize", resize);
      for (const { plot } of made) plot.destroy();
      box.replaceChildren();
    },
  };
}
