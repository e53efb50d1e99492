/** The episode from above: the scene, whoever is in it, and what the driving system holds to be there. */

import { h } from "../../dom.js";
import { canvas } from "../../parts/charts.js";
import { drawCar, drawWalker, strokeBox } from "./bodies.js";
import { eachRow, LABELS } from "./episode.js";
import { palette } from "./palette.js";
import { drawScene, linePath, scenePaths } from "./scene_paths.js";

const ACROSS_M = 84;
const LOOK_AHEAD_M = 12;
const SMOOTHED_S = 2;
const ZOOM = 1.3;
const MOST_PX_PER_M = 60;
const LEAST_PX_PER_M = 1;
const TRAIL_SAMPLES = 1200;
const MATCH_M = 2.5;
/** A perceived obstacle this close to a road user of its kind is that road user; any other is a ghost. */
const KINDS = ["vehicle", "pedestrian"];

/** Return the map of a player's episode, with its buttons. */
export function map(player) {
  const { episode, signal } = player;
  const { told } = episode;
  const colours = palette();
  const paths = scenePaths(told.scene);
  const route = linePath(told.route);
  const centres = smoothed(episode);
  let zoom = 1;
  let perceived = true;
  let names = false;

  const sheet = canvas({
    label: "The episode from above; the text beside it says speed, plan and traffic light", ratio: episode.film ? 1.3 : 1.6, least: 240, most: 560, signal,
    recolour: colours.renew, draw,
  });
  const button = (words, label, onclick) => h("button", { type: "button", "aria-label": label, onclick }, words);
  const zoomBy = (factor) => {
    zoom = factor ? zoom * factor : 1;
    sheet.redraw();
  };
  const hasPerceived = told.perceived.first.at(-1) > 0;
  const node = h("div.replay-map", null, sheet,
    h("div.map-zoom", { role: "group", "aria-label": "Zoom" }, button("+", "Nearer", () => zoomBy(ZOOM)),
      button("−", "Farther", () => zoomBy(1 / ZOOM)), button("1:1", "As at first", () => zoomBy(0))));
  const keys = h("ul.legend.replay-legend", null,
    key("ego", "the car under test"), key("vehicle", "vehicle"), key("pedestrian", "person", "round"), key("route", "its route", "line"),
    hasPerceived && key("injected", "perceived; crossed out: nothing is there", "dashed"));
  const toggles = h("div.inline", null,
    hasPerceived && check("What it perceives", true, (on) => (perceived = on)), check("Names", false, (on) => (names = on)));

  function check(words, on, take) {
    return h("label", null, h("input", { type: "checkbox", checked: on, onchange: (event) => {
      take(event.target.checked);
      sheet.redraw();
    } }), ` ${words}`);
  }

  function draw(pen, width, height, scale) {
    const wanted = (Math.max(width, 360) / ACROSS_M) * zoom;
    const pxPerM = Math.min(MOST_PX_PER_M, Math.max(LEAST_PX_PER_M, wanted));
    zoom *= pxPerM / wanted; // at a limit, a click the other way shows at once
    const at = episode.between(player.time_s);
    const centre = lerp(centres, at);
    const toPx = (x, y) => [width / 2 + (x - centre.x) * pxPerM, height / 2 - (y - centre.y) * pxPerM];
    pen.fillStyle = colours.ground;
    pen.fillRect(0, 0, width, height);
    const [left, top] = toPx(0, 0);
    pen.setTransform(scale * pxPerM, 0, 0, -scale * pxPerM, scale * left, scale * top);
    const metresPerPx = 1 / pxPerM;
    drawScene(pen, paths, route, colours, metresPerPx);
    const ego = episode.pose(told.ego, at);
    drawTrail(pen, ego, at, metresPerPx);
    const texts = [];
    for (const actor of told.actors) drawActor(pen, actor, at, metresPerPx, texts);
    if (perceived) drawPerceived(pen, at.sample, metresPerPx, texts);
    if (ego) {
      const violated = Object.values(told.robustness).some((series) => series[at.sample] !== null && series[at.sample] < 0);
      drawCar(pen, ego, told.ego, colours.ego, colours, {
        accel: episode.accel(told.ego, at.sample), outline: violated ? colours.violation : null, metresPerPx,
      });
    }
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    write(pen, texts, toPx, width);
    drawScaleBar(pen, pxPerM, width, height);
  }

  function drawTrail(pen, ego, { sample }, metresPerPx) {
    if (!ego || sample === 0) return;
    pen.strokeStyle = colours.ego;
    pen.globalAlpha = 0.5;
    pen.lineWidth = Math.max(0.22, 1.5 * metresPerPx);
    pen.beginPath();
    let drawing = false;
    for (let index = Math.max(0, sample - TRAIL_SAMPLES); index <= sample; index += 1) {
      const x = told.ego.x_m[index];
      const y = told.ego.y_m[index];
      if (x === null || y === null) continue;
      if (drawing) pen.lineTo(x, y);
      else pen.moveTo(x, y);
      drawing = true;
    }
    pen.lineTo(ego.x, ego.y);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  function drawActor(pen, actor, at, metresPerPx, texts) {
    const pose = episode.pose(actor, at);
    if (!pose) return;
    if (actor.kind === "pedestrian") drawWalker(pen, pose, colours, metresPerPx);
    else drawCar(pen, pose, actor, colours.vehicle, colours, { accel: episode.accel(actor, at.sample), metresPerPx });
    if (names) texts.push({ x: pose.x, y: pose.y, above_m: actor.width_m / 2, words: actor.name, fill: colours.ink });
  }

  function drawPerceived(pen, sample, metresPerPx, texts) {
    eachRow(told.perceived, sample, (row, columns) => {
      const [x, y, vx, vy] = ["x_m", "y_m", "vx_mps", "vy_mps"].map((name) => columns[name][row]);
      if (x === null || y === null) return;
      const label = columns.label[row];
      const yaw = Math.hypot(vx, vy) > 1 ? Math.atan2(vy, vx) : told.ego.yaw_rad[sample] ?? 0;
      const ghost = !isReal(sample, label, x, y);
      const [length_m, width_m] = [Math.max(0.8, columns.length_m[row] ?? 0), Math.max(0.8, columns.width_m[row] ?? 0)];
      pen.strokeStyle = colours.injected;
      pen.lineWidth = 2 * metresPerPx;
      pen.setLineDash([5 * metresPerPx, 4 * metresPerPx]);
      strokeBox(pen, { x, y, yaw }, length_m, width_m, ghost);
      pen.setLineDash([]);
      const word = LABELS[label] ?? "obstacle";
      texts.push({ x, y, above_m: width_m / 2, words: ghost ? `perceives a ${word}` : word, fill: colours.injected });
    });
  }

  function isReal(sample, label, x, y) {
    return told.actors.some((actor) => actor.kind === (KINDS[label] ?? KINDS[0]) && actor.x_m[sample] !== null
      && Math.hypot(actor.x_m[sample] - x, actor.y_m[sample] - y) < MATCH_M);
  }

  function write(pen, texts, toPx, width) {
    pen.font = "600 12px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.textBaseline = "bottom";
    pen.lineWidth = 3;
    pen.lineJoin = "round";
    pen.strokeStyle = colours.paper;
    const placed = [];
    for (const { x, y, above_m, words, fill } of texts) {
      const half = pen.measureText(words).width / 2;
      let [left, top] = toPx(x, y + above_m);
      left = Math.min(Math.max(left, half + 4), width - half - 4);
      top -= 4;
      // Two labels on one spot read as neither: the later one makes way.
      while (placed.some((other) => Math.abs(other.left - left) < half + other.half && Math.abs(other.top - top) < 15)) top -= 15;
      placed.push({ left, top, half });
      pen.strokeText(words, left, top);
      pen.fillStyle = fill;
      pen.fillText(words, left, top);
    }
  }

  function drawScaleBar(pen, pxPerM, width, height) {
    const long_m = [1, 2, 5, 10, 20, 50, 100].find((metres) => metres * pxPerM >= 50) ?? 200;
    const [left, bottom] = [12, height - 12];
    pen.fillStyle = colours.paper;
    pen.globalAlpha = 0.75;
    pen.fillRect(left - 6, bottom - 22, Math.max(long_m * pxPerM, 40) + 12, 28);
    pen.globalAlpha = 1;
    pen.fillStyle = colours.ink;
    pen.fillRect(left, bottom - 3, long_m * pxPerM, 3);
    pen.font = "12px system-ui, sans-serif";
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(`${long_m} m`, left, bottom - 4);
  }

  player.listen((_, changed) => changed.time && sheet.redraw());
  return { node, keys, toggles };
}

function key(name, words, shape = "") {
  return h("li", null, h("i", { class: `key ${name} ${shape}`.trim() }), words);
}

/** Return where the middle of the map is at each sample: some way ahead of the ego, smoothed so that it does not swing. */
function smoothed(episode) {
  const { ego } = episode.told;
  const n = episode.times.length;
  const ahead = { x: new Float64Array(n), y: new Float64Array(n) };
  for (let i = 0; i < n; i += 1) {
    const known = ego.x_m[i] !== null && ego.y_m[i] !== null;
    const yaw = ego.yaw_rad[i] ?? 0;
    ahead.x[i] = known ? ego.x_m[i] + LOOK_AHEAD_M * Math.cos(yaw) : i ? ahead.x[i - 1] : 0;
    ahead.y[i] = known ? ego.y_m[i] + LOOK_AHEAD_M * Math.sin(yaw) : i ? ahead.y[i - 1] : 0;
  }
  const step_s = (episode.end_s - episode.start_s) / Math.max(1, n - 1);
  const half = Math.round(SMOOTHED_S / 2 / Math.max(1e-3, step_s));
  return { x_m: averaged(ahead.x, half), y_m: averaged(ahead.y, half) };
}

/** Return means over so many values before and after each; past the ends, what would come if it went on as there. */
function averaged(values, half) {
  const n = values.length;
  const padded = new Float64Array(n + 2 * half + 1);
  const value = (i) => {
    if (i < 0) return 2 * values[0] - values[Math.min(n - 1, -i)];
    if (i >= n) return 2 * values[n - 1] - values[Math.max(0, 2 * n - 2 - i)];
    return values[i];
  };
  for (let i = 0; i < n + 2 * half; i += 1) padded[i + 1] = padded[i] + value(i - half);
  return values.map((_, i) => (padded[i + 2 * half + 1] - padded[i]) / (2 * half + 1));
}

function lerp({ x_m, y_m }, { sample, share }) {
  const next = Math.min(x_m.length - 1, sample + 1);
  return { x: x_m[sample] + share * (x_m[next] - x_m[sample]), y: y_m[sample] + share * (y_m[next] - y_m[sample]) };
}
