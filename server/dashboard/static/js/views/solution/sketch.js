/** What the camera sees, as a sketch: the flat scene in perspective, what is there, and what was reported to be. */

import { eachRow, LABELS } from "./episode.js";
import { surfaceColours } from "./palette.js";

const FROM_M = 0.4;
const TO_M = 90;
const FAR_PX = 4000;
/** Points are drawn at most this far outside of the picture. */
const UPRIGHT_M = { building: 6, "parked-car": 1.4, tree: 4.5 };
/** How high the sketch makes what stands up: the trace knows footprints only. */

/** Draws the camera's picture of any sample of one episode. */
export class Sketch {
  constructor(episode, colours) {
    this.episode = episode;
    this.colours = colours;
    this.camera = episode.camera;
    this.areas = episode.told.scene.filter((surface) => surface.closed && surface.points.length > 2);
  }

  /** Draw a sample into a picture of a width and height in px. */
  draw(pen, sample, width, height) {
    const { camera, colours } = this;
    this.scale = { x: width / camera.width_px, y: height / camera.height_px };
    const horizon = camera.horizon_px * this.scale.y;
    pen.fillStyle = colours.sky;
    pen.fillRect(0, 0, width, horizon);
    pen.fillStyle = colours.ground;
    pen.fillRect(0, horizon, width, height - horizon);
    this.#drawScene(pen, sample);
    drawBoxes(pen, this.episode, sample, { colours, scale: this.scale, width, height });
  }

  #drawScene(pen, sample) {
    const { ego } = this.episode.told;
    const [x, y, yaw] = [ego.x_m[sample], ego.y_m[sample], ego.yaw_rad[sample]];
    if (x === null || y === null || yaw === null) return;
    const [cosine, sine] = [Math.cos(yaw), Math.sin(yaw)];
    const upright = [];
    for (const { kind, points } of this.areas) {
      const seen = points.map(([px, py]) => {
        const [dx, dy] = [px - x, py - y];
        return [dx * cosine + dy * sine - this.camera.forward_m, dy * cosine - dx * sine];
      });
      const depths = seen.map(([depth]) => depth);
      const [nearest, farthest] = [Math.min(...depths), Math.max(...depths)];
      if (farthest <= FROM_M || nearest >= TO_M || (nearest > 0 && beside(seen))) continue;
      if (UPRIGHT_M[kind]) {
        upright.push({ kind, seen, depth: nearest + farthest });
        continue;
      }
      const corners = nearest >= FROM_M ? seen : cut(seen);
      if (corners.length > 2) this.#fill(pen, corners.map((corner) => this.#project(corner, 0)), surfaceColours(kind)[0]);
    }
    upright.sort((a, b) => b.depth - a.depth);
    for (const { kind, seen } of upright) this.#drawUpright(pen, kind, seen);
  }

  /** Draw the walls over a footprint, farthest first; those across the view lighter than those along it. */
  #drawUpright(pen, kind, seen) {
    const corners = cut(seen);
    if (corners.length < 2) return;
    const [fill, edge] = surfaceColours(kind);
    const walls = corners.map((corner, index) => {
      const before = corners.at(index - 1);
      return { corner, before, depth: corner[0] + before[0], along: Math.abs(corner[0] - before[0]) > Math.abs(corner[1] - before[1]) };
    }).sort((a, b) => b.depth - a.depth);
    for (const { corner, before, along } of walls) {
      const wall = [this.#project(before, 0), this.#project(corner, 0),
        this.#project(corner, UPRIGHT_M[kind]), this.#project(before, UPRIGHT_M[kind])];
      this.#fill(pen, wall, along && edge ? edge : fill);
    }
  }

  #fill(pen, points, use) {
    pen.fillStyle = this.colours[use];
    pen.beginPath();
    points.forEach(([px, py], index) => (index ? pen.lineTo(px, py) : pen.moveTo(px, py)));
    pen.fill();
  }

  /** Return a point (depth, left) at a height above the ground in px of the picture. */
  #project([depth, left], height_m) {
    const { camera } = this;
    const away = Math.max(depth, FROM_M);
    const px = camera.centre_x_px - (camera.focal_px * left) / away;
    const py = camera.horizon_px + (camera.focal_px * (camera.height_m - height_m)) / away;
    return [clamp(px) * this.scale.x, clamp(py) * this.scale.y];
  }
}

/** Draw what is there as solid boxes, the nearest last, and what was reported as dashed ones with their labels. */
function drawBoxes(pen, episode, sample, { colours, scale, width, height }) {
  const rows = [];
  eachRow(episode.told.seen, sample, (row, columns) => rows.push([row, columns.y_max_px[row]]));
  rows.sort((a, b) => a[1] - b[1]);
  const box = (row, columns) => {
    const at = (name, by, most) => Math.min(most - 1, Math.max(1, columns[name][row] * by));
    const [left, right] = [at("x_min_px", scale.x, width), at("x_max_px", scale.x, width)];
    const [top, bottom] = [at("y_min_px", scale.y, height), at("y_max_px", scale.y, height)];
    return [left, top, right - left, bottom - top];
  };
  const seen = episode.told.seen.columns;
  for (const [row] of rows) {
    const at = box(row, seen);
    pen.globalAlpha = 0.6;
    pen.fillStyle = seen.label[row] === 1 ? colours.pedestrian : colours.vehicle;
    pen.fillRect(...at);
    pen.globalAlpha = 1;
    pen.strokeStyle = colours.seen;
    pen.lineWidth = 2;
    pen.strokeRect(...at);
  }
  eachRow(episode.told.given, sample, (row, columns) => {
    const at = box(row, columns);
    pen.strokeStyle = colours.injected;
    pen.lineWidth = 2;
    pen.setLineDash([7, 4]);
    pen.strokeRect(...at);
    pen.setLineDash([]);
    label(pen, LABELS[columns.label[row]] ?? "obstacle", at, width, colours.injected, colours.paper);
  });
}

/** Write a word above a box, inside the picture. */
export function label(pen, word, [left, top, , high], width, fill, ground) {
  pen.font = "600 12px system-ui, sans-serif";
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  const wide = pen.measureText(word).width;
  const x = Math.max(3, Math.min(left + 2, width - wide - 3));
  const y = top > 17 ? top - 2 : Math.max(15, top + high + 15);
  pen.strokeStyle = ground;
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeText(word, x, y);
  pen.fillStyle = fill;
  pen.fillText(word, x, y);
}

/** Whether all of an area lies to one side of the field of view. */
function beside(seen) {
  return seen.every(([depth, left]) => left > Math.max(depth, 0)) || seen.every(([depth, left]) => -left > Math.max(depth, 0));
}

/** Return the part of a polygon beyond the nearest depth that is drawn. */
function cut(points) {
  const kept = [];
  points.forEach((here, index) => {
    const next = points[(index + 1) % points.length];
    if (here[0] >= FROM_M) kept.push(here);
    if (here[0] >= FROM_M !== next[0] >= FROM_M) {
      const share = (FROM_M - here[0]) / (next[0] - here[0]);
      kept.push([FROM_M, here[1] + share * (next[1] - here[1])]);
    }
  });
  return kept;
}

function clamp(px) {
  return Math.min(FAR_PX, Math.max(-FAR_PX, px));
}
