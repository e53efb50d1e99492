/** Colours, labels and legend keys that the canvases of a replay share. */

import { h } from "../../dom.js";
import { colour } from "../../theme.js";

export const FONT = "12px system-ui, sans-serif";
export const BOLD = "600 12px system-ui, sans-serif";

const COLOURS = {
  ground: "--ground", sky: "--replay-sky", edge: "--replay-edge", ego: "--safe", vehicle: "--series-6", pedestrian: "--series-4",
  glass: "--card", brake: "--bad", route: "--replay-route", injected: "--unsafe", seen: "--measured", violation: "--bad",
  ink: "--ink", muted: "--muted", paper: "--card", line: "--line", pictureShade: "--picture-shade",
};
const PAINTS = {
  road: "--road", pavement: "--replay-pavement", marking: "--marking", building: "--building", "parked-car": "--replay-parked",
  tree: "--replay-tree",
};

/**
 * Return the colours of a replay by use; ``paint(surface)`` returns that of a surface, ``renew()`` reads them again. They are
 * read once per theme: a canvas that moves cannot do that in every frame.
 */
export function palette() {
  const paints = {};
  const found = { renew, paint: (surface) => paints[surface.paint] ?? paints.pavement };
  function renew() {
    for (const [use, name] of Object.entries(COLOURS)) found[use] = colour(name);
    for (const [paint, name] of Object.entries(PAINTS)) paints[paint] = colour(name);
  }
  renew();
  return found;
}

/** Write a word with a halo that keeps it legible on any ground. */
export function writeHaloed(pen, word, x, y, fill, halo) {
  pen.strokeStyle = halo;
  pen.lineWidth = 3;
  pen.lineJoin = "round";
  pen.strokeText(word, x, y);
  pen.fillStyle = fill;
  pen.fillText(word, x, y);
}

const LINE_PX = 15;
const EDGE_PX = 3;

/**
 * @typedef {object} Label
 * @property {string} words
 * @property {string} fill
 * @property {number[]} box What it names: left, top, width and height in px.
 */

/**
 * Return where labels are written, most important first: close to what they name, inside the picture, none over another.
 * A label without such a place is left out, as is that of a box outside the picture.
 *
 * @param {Label[]} labels The most important first.
 * @param {number} width Of the picture in px.
 * @param {number} height
 * @param {(words: string) => number} measure Returns the width of words in px.
 * @returns {(Label & {left: number, bottom: number, wide: number})[]}
 */
export function labelPlaces(labels, width, height, measure) {
  const placed = [];
  for (const label of labels) {
    const [left, top, across, high] = label.box;
    if (left > width || top > height || left + across < 0 || top + high < 0) continue;
    const wide = measure(label.words);
    const at = Math.max(EDGE_PX, Math.min(left + across / 2 - wide / 2, width - wide - EDGE_PX));
    if (wide + 2 * EDGE_PX > width) continue;
    const free = (bottom) => bottom - LINE_PX >= 0 && bottom <= height
      && placed.every((other) => at >= other.left + other.wide + EDGE_PX || other.left >= at + wide + EDGE_PX || Math.abs(other.bottom - bottom) >= LINE_PX);
    const bottom = [top - 2, top + high + LINE_PX + 1, top - 2 - LINE_PX, top + high + 2 * LINE_PX + 1].find(free);
    if (bottom !== undefined) placed.push({ ...label, left: at, bottom, wide });
  }
  return placed;
}

/** Write labels, the most important first, beside what they name in a picture of some size; see `labelPlaces`. */
export function writeLabels(pen, labels, width, height, halo) {
  pen.font = BOLD;
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  for (const { words, fill, left, bottom } of labelPlaces(labels, width, height, (words) => pen.measureText(words).width)) {
    writeHaloed(pen, words, left, bottom, fill, halo);
  }
}

/** Draw a straight line. */
export function drawLine(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

/** Add a line through points to a path. */
export function tracePath(path, points, closed = false) {
  points.forEach(([x, y], index) => (index ? path.lineTo(x, y) : path.moveTo(x, y)));
  if (closed) path.closePath();
  return path;
}

/** Return an entry of a legend: a sample of the line or fill, and its meaning. */
export function key(classes, words) {
  return h("li", null, h("i", { class: `key ${classes}` }), words);
}
