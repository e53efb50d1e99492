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

/** Write a word above a box, inside a picture of some width. */
export function labelBox(pen, word, [left, top, , high], width, fill, halo) {
  pen.font = BOLD;
  pen.textAlign = "left";
  pen.textBaseline = "bottom";
  const wide = pen.measureText(word).width;
  const x = Math.max(3, Math.min(left + 2, width - wide - 3));
  writeHaloed(pen, word, x, top > 17 ? top - 2 : Math.max(15, top + high + 15), fill, halo);
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
