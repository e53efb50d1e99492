/** Rows of a mean with its interval and the single values, on one scale from nought. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { figure } from "../format.js";

const STEPS = 5;

/**
 * Return a chart; its ``update(rows)`` takes rows of ``key``, ``label``, ``colour`` (by name), ``hollow``, ``mean``, ``low``,
 * ``high`` (or null), ``values``.
 *
 * @param {string} label What the chart shows; a table beside it says the same.
 */
export function intervals(label) {
  const rows = h("div");
  const axis = h("div.track.axis");
  const node = h("div.intervals", { role: "img", "aria-label": label }, rows, h("div.interval", null, h("span"), axis, h("span")));
  node.update = (given, said = label) => {
    const top = roundTop(Math.max(0, ...given.flatMap((row) => [row.mean, row.high ?? 0, ...row.values])));
    attribute(node, "aria-label", said);
    keyed(rows, given.map((row) => ({ ...row, top })), (row) => row.key, intervalRow);
    replace(axis, ticks(top).map((value) => at(h("span.tick", null, figure(value)), value / top)));
  };
  return node;
}

function intervalRow(first) {
  const name = h("span.name");
  const track = h("div.track");
  const said = h("span.said.figure");
  const node = h("div.interval", null, name, track, said);
  node.update = (row) => {
    text(name, row.label);
    track.style.setProperty("--of", `var(${row.colour})`);
    node.classList.toggle("hollow", Boolean(row.hollow));
    replace(track, ticks(row.top).map((value) => at(h("i.line"), value / row.top)),
      row.low !== null && wide(h("i.range"), Math.max(0, row.low) / row.top, row.high / row.top),
      row.values.map((value) => at(h("i.one"), value / row.top)), at(h("i.mean"), row.mean / row.top));
    text(said, inWords(row));
  };
  node.update(first);
  return node;
}

/** ``43.8 [28.7, 58.9]``, as the report has it. */
export function inWords({ mean, low, high }) {
  const short = (value) => value.toFixed(1);
  return low === null || low === undefined ? short(mean) : `${short(mean)} [${short(Math.max(0, low))}, ${short(high)}]`;
}

function at(node, share) {
  node.style.left = `${100 * share}%`;
  return node;
}

function wide(node, from, to) {
  node.style.width = `${100 * (to - from)}%`;
  return at(node, from);
}

/** The next round number above a value. */
function roundTop(value) {
  if (value <= 0) return 1;
  const step = roundStep(value / STEPS);
  return step * Math.ceil(value / step - 1e-9);
}

function roundStep(least) {
  const size = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].map((factor) => factor * size).find((step) => step >= least - 1e-12);
}

function ticks(top) {
  const step = roundStep(top / STEPS);
  return Array.from({ length: Math.round(top / step) + 1 }, (_, index) => index * step);
}
