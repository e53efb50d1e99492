/** The episode from above: the scene, the road users in it, and the obstacles that the driving system perceives. */

import { h } from "../../dom.js";
import { canvas } from "../../parts/charts.js";
import { colour } from "../../theme.js";
import { FONT, key, palette, tracePath, writeLabels } from "./drawing.js";
import { eachRow } from "./episode.js";

const ACROSS_M = 84;
const ZOOM = 1.3;
const MOST_PX_PER_M = 60;
const LEAST_PX_PER_M = 1;
const TRAIL_SAMPLES = 1200;
const LEAST_PERSON_PX = 3.5;
const HIDDEN_ALPHA = 0.35;
/** Opacity of road users that are hidden from the camera. */
const SAME_PLACE_M = 0.3;

/**
 * Return the map of a player's episode, its legend and its switches.
 *
 * @param {import("./episode.js").Player} player
 * @param {{twin: import("./episode.js").Episode, words: string, colour: string, own: string, ownWords: string}} [second] A second
 *   drive on the same road whose car is shown as an outline, with its name and the name of its colour, and the same of the own car.
 */
export function map(player, second = null) {
  const { episode, signal } = player;
  const { data } = episode;
  const colours = palette();
  const below = surfacePaths(data.scene.slice(0, data.route_layer));
  const above = surfacePaths(data.scene.slice(data.route_layer));
  const route = tracePath(new Path2D(), data.route);
  const car = carPaths(data.shapes);
  let zoom = 1;
  let perceived = true;
  let names = false;

  const sheet = canvas({
    label: "The episode from above; the text next to it gives speed, plan and traffic light", ratio: episode.film ? 1.3 : 1.6, least: 240,
    most: 560, signal, recolour: colours.renew, draw,
  });
  const button = (sign, label, onclick) => h("button", { type: "button", "aria-label": label, onclick }, sign);
  const zoomBy = (factor) => {
    zoom = factor ? zoom * factor : 1;
    sheet.redraw();
  };
  const hasHidden = data.actors.some((actor) => actor.hidden.some(Boolean));
  const hasPerceived = data.perceived.first.at(-1) > 0;
  const node = h("div.replay-map", null, sheet,
    h("div.map-zoom", { role: "group", "aria-label": "Zoom" }, button("+", "Zoom in", () => zoomBy(ZOOM)),
      button("−", "Zoom out", () => zoomBy(1 / ZOOM)), button("1:1", "Reset zoom", () => zoomBy(0))));
  const keys = second === null ? [key("ego", "ego (car under test)")] : [[second.own, second.ownWords], [second.colour, second.words]]
    .map(([name, words]) => key(name.slice(2), words));
  const legend = h("ul.legend.replay-legend", null, keys, second && key("outlined", "outline: the other drive at the same time"), key("vehicle", "vehicle"), key("pedestrian round", "person"), hasHidden && key("vehicle hidden", "hidden from the camera"), key("route line", "route of the ego"),
    hasPerceived && key("injected dashed", "perceived (crossed out: ghost)"));
  const switches = h("div.inline", null,
    hasPerceived && check("Perceived obstacles", true, (on) => (perceived = on)), check("Names", false, (on) => (names = on)));

  function check(words, on, take) {
    return h("label", null, h("input", { type: "checkbox", checked: on, onchange: (event) => {
      take(event.target.checked);
      sheet.redraw();
    } }), ` ${words}`);
  }

  function draw(pen, width, height, scale) {
    const wanted = (Math.max(width, 360) / ACROSS_M) * zoom;
    const pxPerM = Math.min(MOST_PX_PER_M, Math.max(LEAST_PX_PER_M, wanted));
    zoom *= pxPerM / wanted; // at a limit, the next click the other way takes effect at once
    const at = episode.between(player.time_s);
    const centre = interpolated(data.centre, at);
    const toPx = (x, y) => [width / 2 + (x - centre.x) * pxPerM, height / 2 - (y - centre.y) * pxPerM];
    pen.fillStyle = colours.ground;
    pen.fillRect(0, 0, width, height);
    const [left, top] = toPx(0, 0);
    pen.setTransform(scale * pxPerM, 0, 0, -scale * pxPerM, scale * left, scale * top);
    const metresPerPx = 1 / pxPerM;
    pen.lineJoin = "round";
    drawSurfaces(pen, below, colours, metresPerPx);
    pen.strokeStyle = second ? ownColour() : colours.route;
    pen.globalAlpha = second ? 0.4 : 1;
    pen.lineWidth = 0.3;
    pen.stroke(route);
    pen.globalAlpha = 1;
    drawSurfaces(pen, above, colours, metresPerPx);
    const ego = episode.pose(data.ego, at);
    drawTrail(pen, ego, at, metresPerPx);
    const labels = [];
    for (const actor of data.actors) drawActor(pen, actor, at, metresPerPx, labels);
    if (perceived) drawPerceived(pen, at.sample, metresPerPx, labels);
    if (ego) drawEgo(pen, ego, at, metresPerPx);
    if (second) drawTwin(pen, ego, metresPerPx, labels);
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    write(pen, labels, ego, { toPx, pxPerM, width, height });
    drawScaleBar(pen, pxPerM, width, height);
  }

  function ownColour() {
    return second ? colour(second.own) : colours.ego;
  }

  function drawTrail(pen, ego, { sample }, metresPerPx) {
    if (!ego || sample === 0) return;
    pen.strokeStyle = ownColour();
    pen.globalAlpha = 0.7;
    pen.lineWidth = Math.max(0.22, 1.5 * metresPerPx);
    pen.beginPath();
    let drawing = false;
    for (let index = Math.max(0, sample - TRAIL_SAMPLES); index <= sample; index += 1) {
      const x = data.ego.x_m[index];
      const y = data.ego.y_m[index];
      if (x === null || y === null) continue;
      if (drawing) pen.lineTo(x, y);
      else pen.moveTo(x, y);
      drawing = true;
    }
    pen.lineTo(ego.x, ego.y);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  function drawEgo(pen, pose, { sample }, metresPerPx) {
    drawCar(pen, car, pose, data.ego, colours, ownColour(), data.ego.brakes[sample]);
    const violated = Object.values(data.robustness).some((series) => series[sample] !== null && series[sample] < 0);
    if (!violated) return;
    pen.strokeStyle = colours.violation;
    pen.lineWidth = 2.5 * metresPerPx;
    strokeBox(pen, pose, data.ego.length_m + 4 * metresPerPx, data.ego.width_m + 4 * metresPerPx);
  }

  function drawTwin(pen, ego, metresPerPx, labels) {
    const { twin, words, colour: name } = second;
    const pose = twin.pose(twin.data.ego, twin.between(player.time_s));
    if (!pose || (ego && Math.hypot(pose.x - ego.x, pose.y - ego.y) < SAME_PLACE_M)) return;
    pen.strokeStyle = colour(name);
    pen.lineWidth = 2 * metresPerPx;
    strokeBox(pen, pose, twin.data.ego.length_m, twin.data.ego.width_m);
    labels.push({ x: pose.x, y: pose.y, above_m: twin.data.ego.width_m / 2, words, fill: colour(name) });
  }

  function drawActor(pen, actor, at, metresPerPx, labels) {
    const pose = episode.pose(actor, at);
    if (!pose) return;
    if (actor.hidden[at.sample]) pen.globalAlpha = HIDDEN_ALPHA;
    if (actor.shape === "person") drawPerson(pen, data.shapes, pose, colours, metresPerPx);
    else drawCar(pen, car, pose, actor, colours, colours.vehicle, actor.brakes[at.sample]);
    pen.globalAlpha = 1;
    if (names) labels.push({ x: pose.x, y: pose.y, above_m: actor.width_m / 2, words: actor.name, fill: colours.ink });
  }

  function drawPerceived(pen, sample, metresPerPx, labels) {
    eachRow(data.perceived, sample, (row, columns) => {
      const [x, y, yaw] = [columns.x_m[row], columns.y_m[row], columns.yaw_rad[row]];
      if (x === null || y === null || yaw === null) return;
      const ghost = columns.ghost[row] === 1;
      pen.strokeStyle = colours.injected;
      pen.lineWidth = 2 * metresPerPx;
      pen.setLineDash([5 * metresPerPx, 4 * metresPerPx]);
      strokeBox(pen, { x, y, yaw }, columns.drawn_length_m[row], columns.drawn_width_m[row], ghost);
      pen.setLineDash([]);
      const words = episode.byLabel(ghost ? "ghosts" : "sighted", columns.label[row]);
      labels.push({ x, y, above_m: columns.drawn_width_m[row] / 2, words, fill: colours.injected });
    });
  }

  /** Write the labels of what is near the ego first: they matter most, and the others make way. */
  function write(pen, labels, ego, { toPx, pxPerM, width, height }) {
    const away = ({ x, y }) => (ego ? Math.hypot(x - ego.x, y - ego.y) : 0);
    const near = labels.sort((a, b) => away(a) - away(b)).map(({ x, y, above_m, words, fill }) => {
      const [middle, top] = toPx(x, y + above_m);
      return { words, fill, box: [middle, top, 0, 2 * above_m * pxPerM] };
    });
    writeLabels(pen, near, width, height, colours.paper);
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
    pen.font = FONT;
    pen.textAlign = "left";
    pen.textBaseline = "bottom";
    pen.fillText(`${long_m} m`, left, bottom - 4);
  }

  player.listen((_, changed) => changed.time && sheet.redraw());
  return { node, legend, switches };
}

function interpolated({ x_m, y_m }, { sample, share }) {
  const next = Math.min(x_m.length - 1, sample + 1);
  return { x: x_m[sample] + share * (x_m[next] - x_m[sample]), y: y_m[sample] + share * (y_m[next] - y_m[sample]) };
}

/** Return surfaces as paths in metres, in the order of drawing; neighbours that look alike share a path. */
function surfacePaths(surfaces) {
  const found = [];
  for (const surface of surfaces) {
    if (surface.points.length < 2) continue;
    let last = found.at(-1);
    if (!last || ["paint", "outlined", "closed", "width_m"].some((name) => last.surface[name] !== surface[name])) {
      last = { path: new Path2D(), surface };
      found.push(last);
    }
    tracePath(last.path, surface.points, surface.closed);
  }
  return found;
}

function drawSurfaces(pen, paths, colours, metresPerPx) {
  for (const { path, surface } of paths) {
    if (!surface.closed) {
      pen.strokeStyle = colours.paint(surface);
      pen.lineWidth = Math.max(surface.width_m, metresPerPx);
      pen.stroke(path);
      continue;
    }
    pen.fillStyle = colours.paint(surface);
    pen.fill(path);
    if (surface.outlined) {
      pen.strokeStyle = colours.edge;
      pen.lineWidth = metresPerPx;
      pen.stroke(path);
    }
  }
}

/** Return the parts of a car as paths in half lengths and half widths. */
function carPaths({ car_body, car_windows, car_brake_lights }) {
  const path = (rings) => rings.reduce((whole, ring) => tracePath(whole, ring, true), new Path2D());
  return { body: path([car_body]), windows: path(car_windows), brakeLights: path(car_brake_lights) };
}

function drawCar(pen, car, pose, { length_m, width_m }, colours, fill, brakes) {
  pen.save();
  pen.translate(pose.x, pose.y);
  pen.rotate(pose.yaw);
  pen.scale(length_m / 2, width_m / 2);
  pen.fillStyle = fill;
  pen.fill(car.body);
  pen.fillStyle = colours.glass;
  pen.fill(car.windows);
  if (brakes) {
    pen.fillStyle = colours.brake;
    pen.fill(car.brakeLights);
  }
  pen.restore();
}

/** Draw a person as a disc with a nose, never too small to see. */
function drawPerson(pen, { person_radius_m, person_nose }, pose, colours, metresPerPx) {
  const radius = Math.max(LEAST_PERSON_PX * metresPerPx, person_radius_m);
  const reach = person_nose * radius;
  pen.strokeStyle = colours.pedestrian;
  pen.lineWidth = 0.6 * radius;
  pen.beginPath();
  pen.moveTo(pose.x, pose.y);
  pen.lineTo(pose.x + reach * Math.cos(pose.yaw), pose.y + reach * Math.sin(pose.yaw));
  pen.stroke();
  pen.fillStyle = colours.pedestrian;
  pen.strokeStyle = colours.paper;
  pen.lineWidth = metresPerPx;
  pen.beginPath();
  pen.arc(pose.x, pose.y, radius, 0, 2 * Math.PI);
  pen.fill();
  pen.stroke();
}

/** Draw the outline of a box, and its diagonals if it is crossed out. */
function strokeBox(pen, pose, length_m, width_m, crossed = false) {
  pen.save();
  pen.translate(pose.x, pose.y);
  pen.rotate(pose.yaw);
  const [l, w] = [length_m / 2, width_m / 2];
  pen.beginPath();
  pen.rect(-l, -w, length_m, width_m);
  if (crossed) {
    pen.moveTo(-l, -w);
    pen.lineTo(l, w);
    pen.moveTo(-l, w);
    pen.lineTo(l, -w);
  }
  pen.stroke();
  pen.restore();
}
