/** The camera's picture next to the map: the film if there is one, or a sketch made from the recorded boxes. */

import { ApiError, request } from "../../api.js";
import { h, text } from "../../dom.js";
import { canvas } from "../../parts/charts.js";
import { key, palette, writeLabels } from "./drawing.js";
import { eachRow, rowCount } from "./episode.js";

const PERSON = 1;
const FAR_PX = 4000;
/** Points are drawn at most this far outside the picture. */
const PICTURES_KEPT = 60;
const PICTURES_AHEAD = 12;
const REQUESTS_AT_ONCE = 4;
const RETRY_MS = 3_000;

/**
 * Return the camera's view of a player's episode.
 *
 * @param {import("./episode.js").Player} player
 * @param {string} path Of the solution.
 */
export function camera(player, path) {
  const { episode, signal } = player;
  const { film, data, words } = episode;
  if (!film && rowCount(data.seen) + rowCount(data.given) === 0) {
    return h("div.replay-camera", null, h("h3", null, "Camera"),
      h("p.hint", null, "No boxes were recorded: in this episode the driving system receives the true positions of road users."));
  }
  const colours = palette();
  const [width, height] = film ? film.size_px : [episode.camera.width_px, episode.camera.height_px];
  const status = h("p.hint", { role: "status" });
  const sheet = canvas({
    label: film ? "Camera picture with ground truth and detections" : "Sketch of the camera picture with ground truth and reported boxes",
    ratio: width / height, most: 520, signal, recolour: colours.renew, draw,
  });
  const painter = film ? new FilmPainter(episode, colours, path, () => sheet.redraw(), signal) : new SketchPainter(episode, colours);

  function draw(pen, wide, high) {
    painter.draw(pen, player.sample, wide, high);
    if (film) text(status, painter.missing(player.sample) ? "This picture is no longer available." : "");
  }

  player.listen((_, changed) => changed.sample && sheet.redraw());
  return h("div.replay-camera", null, h("h3", null, film ? "Camera" : "Camera (sketch)"), sheet, status, film ? filmLegend() : sketchLegend());

  function filmLegend() {
    const regions = Object.keys(film.regions);
    return [
      h("ul.legend", null, key("box true", "ground truth"), key("box found dashed", `detected with a score of at least ${film.threshold}`),
        regions.length > 0 && key("box region", `a person here triggers the brake${regions.length > 1 ? " (dotted: a vehicle)" : ""}`)),
      h("label.check.small", null, h("input", { type: "checkbox", onchange: (event) => {
        painter.showsAll = event.target.checked;
        sheet.redraw();
      } }), ` Also show lower scores, from ${film.least_score}`),
    ];
  }

  function sketchLegend() {
    return h("ul.legend", null, key("box seen", "ground truth: the component's input"),
      rowCount(data.given) > 0 && key("box given dashed", `${words.report}: reported to the driving system`));
  }
}

/** Draws the picture that a film shows at any sample of one episode, with its boxes. */
class FilmPainter {
  #drawn = -1;

  constructor(episode, colours, path, redraw, signal) {
    this.episode = episode;
    this.film = episode.film;
    this.colours = colours;
    this.pictures = new Pictures(path, this.film.samples.length, redraw, signal);
    this.showsAll = false;
  }

  /** Draw a sample with a width and height in px. The previous picture stays until the next one arrives. */
  draw(pen, sample, width, height) {
    const { film, pictures } = this;
    const wanted = film.shown[sample] ?? -1;
    const here = wanted < 0 ? null : pictures.at(wanted);
    if (here || pictures.isMissing(wanted)) this.#drawn = wanted;
    const bitmap = here ?? pictures.cached(this.#drawn);
    pen.fillStyle = this.colours.pictureShade;
    pen.fillRect(0, 0, width, height);
    if (bitmap) pen.drawImage(bitmap, 0, 0, width, height);
    const index = this.#drawn >= 0 ? this.#drawn : wanted;
    if (index >= 0) this.#drawBoxes(pen, film.samples[index], width, height);
  }

  /** Return whether the picture of a sample is unavailable. */
  missing(sample) {
    return this.pictures.isMissing(this.film.shown[sample] ?? -1);
  }

  #drawBoxes(pen, sample, width, height) {
    const { film, episode, colours } = this;
    const [x, y] = [width / film.size_px[0], height / film.size_px[1]];
    for (const [name, corners] of Object.entries(film.regions)) {
      pen.strokeStyle = film.colours.region;
      pen.lineWidth = 1.5;
      pen.setLineDash(name === film.person_region ? [] : [3, 4]);
      pen.beginPath();
      corners.forEach(([px, py], index) => (index ? pen.lineTo(px * x, Math.min(height - 1, py * y)) : pen.moveTo(px * x, py * y)));
      pen.closePath();
      pen.stroke();
    }
    pen.setLineDash([]);
    const box = (row, columns) => [columns.x_min_px[row] * x, columns.y_min_px[row] * y,
      (columns.x_max_px[row] - columns.x_min_px[row]) * x, (columns.y_max_px[row] - columns.y_min_px[row]) * y];
    eachRow(film.judged, sample, (row, columns) => {
      if (columns.ignored[row]) return;
      pen.strokeStyle = film.colours.judged;
      pen.lineWidth = 2;
      pen.strokeRect(...box(row, columns));
    });
    const names = [];
    eachRow(film.found, sample, (row, columns) => {
      const counts = columns.counts[row] === 1;
      if (!counts && !this.showsAll) return;
      pen.globalAlpha = counts ? 1 : 0.55;
      pen.strokeStyle = film.colours.found;
      pen.lineWidth = counts ? 2 : 1;
      pen.setLineDash([6, 3]);
      pen.strokeRect(...box(row, columns));
      pen.globalAlpha = 1;
      if (counts) names.push({ person: columns.label[row] === PERSON, score: columns.score[row], at: box(row, columns) });
    });
    pen.setLineDash([]);
    names.sort((a, b) => b.person - a.person || b.score - a.score);
    writeLabels(pen, names.map(({ person, score, at }) => ({
      words: `${person ? `${episode.byLabel("labels", PERSON)} ` : ""}${score.toFixed(2)}`, fill: film.colours.found, box: at,
    })), width, height, colours.pictureShade);
  }
}

/** Fetches the pictures of one film: on demand, a few ahead, and keeps a limited number. */
class Pictures {
  #bitmaps = new Map(); // by index, the least recently used first
  #underWay = new Set();
  #wanted = [];
  #missing = new Set();

  /**
   * @param {string} path Of the solution.
   * @param {number} count Number of pictures.
   * @param {() => void} onPicture Called when a picture has arrived.
   * @param {AbortSignal} signal Stops fetching.
   */
  constructor(path, count, onPicture, signal) {
    this.path = path;
    this.count = count;
    this.onPicture = onPicture;
    this.signal = signal;
    signal.addEventListener("abort", () => {
      for (const bitmap of this.#bitmaps.values()) bitmap.close();
      this.#bitmaps.clear();
    }, { once: true });
  }

  /** Return a picture if it is cached; otherwise fetch it. The pictures after it are fetched in advance. */
  at(index) {
    const found = this.#bitmaps.get(index) ?? null;
    if (found) {
      this.#bitmaps.delete(index);
      this.#bitmaps.set(index, found);
    }
    this.#wanted = [];
    for (let next = index; next <= Math.min(this.count - 1, index + PICTURES_AHEAD); next += 1) {
      if (!this.#bitmaps.has(next) && !this.#underWay.has(next) && !this.#missing.has(next)) this.#wanted.push(next);
    }
    this.#fetch();
    return found;
  }

  /** Return a picture if it is cached; fetch nothing. */
  cached(index) {
    return this.#bitmaps.get(index) ?? null;
  }

  /** Return whether a picture is unavailable. */
  isMissing(index) {
    return this.#missing.has(index);
  }

  #fetch() {
    while (this.#underWay.size < REQUESTS_AT_ONCE && this.#wanted.length && !this.signal.aborted) this.#load(this.#wanted.shift());
  }

  async #load(index) {
    this.#underWay.add(index);
    try {
      const answer = await request("GET", `${this.path}/pictures/${index}.jpg`, { signal: this.signal });
      const bitmap = await createImageBitmap(await answer.blob());
      if (this.signal.aborted) {
        bitmap.close();
        return;
      }
      this.#bitmaps.set(index, bitmap);
      for (const [oldest, old] of this.#bitmaps) {
        if (this.#bitmaps.size <= PICTURES_KEPT) break;
        old.close();
        this.#bitmaps.delete(oldest);
      }
    } catch (error) {
      if (this.signal.aborted) return;
      // A temporary error is retried later; any other error means that the picture is unavailable.
      if (error instanceof ApiError && error.passes) {
        setTimeout(this.onPicture, RETRY_MS);
        return;
      }
      this.#missing.add(index);
    } finally {
      this.#underWay.delete(index);
      this.#fetch();
    }
    this.onPicture();
  }
}

/** Sketches the camera's picture of any sample of one episode: the flat scene in perspective, ground truth, reported boxes. */
class SketchPainter {
  constructor(episode, colours) {
    this.episode = episode;
    this.colours = colours;
    this.camera = episode.camera;
    this.areas = episode.data.scene.filter((surface) => surface.closed && surface.points.length > 2);
  }

  /** Draw a sample with a width and height in px. */
  draw(pen, sample, width, height) {
    const { camera, colours, episode } = this;
    this.scale = { x: width / camera.width_px, y: height / camera.height_px };
    this.size = { width, height };
    this.tanPitch = Math.tan(episode.data.pitch_rad[sample] ?? 0);
    const horizon = (camera.horizon_px + camera.focal_px * this.tanPitch) * this.scale.y;
    pen.fillStyle = colours.sky;
    pen.fillRect(0, 0, width, horizon);
    pen.fillStyle = colours.ground;
    pen.fillRect(0, horizon, width, height - horizon);
    this.#drawAreas(pen, sample);
    this.#drawGroundTruth(pen, episode.data.seen, sample);
    this.#drawReported(pen, episode.data.given, sample);
  }

  #drawAreas(pen, sample) {
    const { camera, colours } = this;
    const { ego } = this.episode.data;
    const [x, y, yaw] = [ego.x_m[sample], ego.y_m[sample], ego.yaw_rad[sample]];
    if (x === null || y === null || yaw === null) return;
    const [cosine, sine] = [Math.cos(yaw), Math.sin(yaw)];
    const standing = [];
    for (const area of this.areas) {
      const seen = area.points.map(([px, py]) => {
        const [dx, dy] = [px - x, py - y];
        return [dx * cosine + dy * sine - camera.forward_m, dy * cosine - dx * sine];
      });
      const depths = seen.map(([depth]) => depth);
      const [nearest, farthest] = [Math.min(...depths), Math.max(...depths)];
      if (farthest <= camera.from_m || nearest >= camera.to_m || (nearest > 0 && isBeside(seen))) continue;
      if (area.height_m > 0) {
        standing.push({ area, seen, depth: nearest + farthest });
        continue;
      }
      const corners = nearest >= camera.from_m ? seen : this.#cut(seen);
      if (corners.length > 2) this.#fill(pen, corners.map((corner) => this.#project(corner, 0)), colours.paint(area));
    }
    standing.sort((a, b) => b.depth - a.depth);
    for (const { area, seen } of standing) this.#drawWalls(pen, area, seen);
  }

  /** Draw the walls over a footprint, farthest first; walls across the view are lighter than those along it. */
  #drawWalls(pen, area, seen) {
    const corners = this.#cut(seen);
    if (corners.length < 2) return;
    const walls = corners.map((corner, index) => {
      const before = corners.at(index - 1);
      return { corner, before, depth: corner[0] + before[0], along: Math.abs(corner[0] - before[0]) > Math.abs(corner[1] - before[1]) };
    }).sort((a, b) => b.depth - a.depth);
    for (const { corner, before, along } of walls) {
      const wall = [this.#project(before, 0), this.#project(corner, 0),
        this.#project(corner, area.height_m), this.#project(before, area.height_m)];
      this.#fill(pen, wall, along && area.outlined ? this.colours.edge : this.colours.paint(area));
    }
  }

  #fill(pen, points, fill) {
    pen.fillStyle = fill;
    pen.beginPath();
    points.forEach(([px, py], index) => (index ? pen.lineTo(px, py) : pen.moveTo(px, py)));
    pen.fill();
  }

  /** Return a point (depth, left) at a height above the ground in px of the picture. */
  #project([depth, left], height_m) {
    const { camera } = this;
    const away = Math.max(depth, camera.from_m);
    const px = camera.centre_x_px - (camera.focal_px * left) / away;
    const level = (camera.height_m - height_m) / away;
    // As in the simulator's camera, pitch moves rows alone.
    const down = (level + this.tanPitch) / Math.max(1 - level * this.tanPitch, 0.1);
    const py = camera.horizon_px + camera.focal_px * down;
    return [clamp(px, -FAR_PX, FAR_PX) * this.scale.x, clamp(py, -FAR_PX, FAR_PX) * this.scale.y];
  }

  /** Return the part of a polygon of (depth, left) beyond the least depth that is drawn. */
  #cut(points) {
    const { from_m } = this.camera;
    const corners = [];
    points.forEach((here, index) => {
      const next = points[(index + 1) % points.length];
      if (here[0] >= from_m) corners.push(here);
      if (here[0] >= from_m !== next[0] >= from_m) {
        const share = (from_m - here[0]) / (next[0] - here[0]);
        corners.push([from_m, here[1] + share * (next[1] - here[1])]);
      }
    });
    return corners;
  }

  /** Draw a solid box for each road user in the picture, the nearest last. */
  #drawGroundTruth(pen, seen, sample) {
    const { colours } = this;
    const rows = [];
    eachRow(seen, sample, (row) => rows.push(row));
    rows.sort((a, b) => seen.columns.y_max_px[a] - seen.columns.y_max_px[b]);
    for (const row of rows) {
      const box = this.#box(row, seen.columns);
      pen.globalAlpha = 0.6;
      pen.fillStyle = seen.columns.label[row] === PERSON ? colours.pedestrian : colours.vehicle;
      pen.fillRect(...box);
      pen.globalAlpha = 1;
      pen.strokeStyle = colours.seen;
      pen.lineWidth = 2;
      pen.strokeRect(...box);
    }
  }

  #drawReported(pen, given, sample) {
    const { colours, episode, size } = this;
    const labels = [];
    eachRow(given, sample, (row, columns) => {
      const box = this.#box(row, columns);
      pen.strokeStyle = colours.injected;
      pen.lineWidth = 2;
      pen.setLineDash([7, 4]);
      pen.strokeRect(...box);
      pen.setLineDash([]);
      labels.push({ words: episode.byLabel("labels", columns.label[row]), fill: colours.injected, box });
    });
    labels.sort((a, b) => b.box[1] + b.box[3] - a.box[1] - a.box[3]); // the nearest first
    writeLabels(pen, labels, size.width, size.height, colours.paper);
  }

  /** Return left, top, width and height of an image box in px of the picture, inside it. */
  #box(row, columns) {
    const { scale, size } = this;
    const [left, right] = ["x_min_px", "x_max_px"].map((name) => clamp(columns[name][row] * scale.x, 1, size.width - 1));
    const [top, bottom] = ["y_min_px", "y_max_px"].map((name) => clamp(columns[name][row] * scale.y, 1, size.height - 1));
    return [left, top, right - left, bottom - top];
  }
}

/** Return whether all of an area lies on one side of the field of view. */
function isBeside(seen) {
  return seen.every(([depth, left]) => left > Math.max(depth, 0)) || seen.every(([depth, left]) => -left > Math.max(depth, 0));
}

function clamp(value, least, most) {
  return Math.min(most, Math.max(least, value));
}
