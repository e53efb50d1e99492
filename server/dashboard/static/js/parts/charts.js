/** Charts: a canvas at screen resolution, line charts by uPlot, and means with intervals. They adapt to theme and available space. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { figure } from "../format.js";
import { colour, onTheme } from "../theme.js";

const SHARPEST = 2;

/**
 * Return an element with a canvas at the resolution of the screen; ``redraw`` draws it, once it has a size.
 *
 * @param {object} given
 * @param {string} given.label Description for screen readers.
 * @param {number} given.ratio Width by height.
 * @param {number} [given.least] Smallest height in px.
 * @param {number} [given.most] Largest height in px.
 * @param {(pen: CanvasRenderingContext2D, width: number, height: number, scale: number) => void} given.draw Draws it in CSS px;
 *   ``scale`` is the number of device pixels per CSS px.
 * @param {() => void} [given.recolour] Called before it is drawn in the colours of another theme.
 * @param {AbortSignal} given.signal
 */
export function canvas({ label, ratio, least = 0, most = Infinity, draw, recolour, signal }) {
  const sheet = h("canvas", { role: "img", "aria-label": label });
  const place = h("div.canvas", null, sheet);
  const pen = sheet.getContext("2d");
  let width = 0;
  let height = 0;
  let scale = 1;

  function fit() {
    const wide = place.clientWidth;
    if (wide === 0) return;
    const high = Math.round(Math.min(most, Math.max(least, wide / ratio)));
    const sharp = Math.min(SHARPEST, devicePixelRatio || 1);
    if (wide === width && high === height && sharp === scale) return;
    [width, height, scale] = [wide, high, sharp];
    sheet.width = Math.round(wide * sharp);
    sheet.height = Math.round(high * sharp);
    sheet.style.width = `${wide}px`;
    sheet.style.height = `${high}px`;
    place.redraw();
  }

  place.sheet = sheet;
  place.redraw = () => {
    if (width === 0 || signal.aborted) return;
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    draw(pen, width, height, scale);
  };
  const seen = new ResizeObserver(fit);
  seen.observe(place);
  onTheme(() => {
    recolour?.();
    place.redraw();
  }, signal);
  signal.addEventListener("abort", () => seen.disconnect(), { once: true });
  return place;
}

/**
 * Return a line chart.
 *
 * @param {object} given
 * @param {string} given.label Description for screen readers.
 * @param {string} given.x Name of the horizontal axis.
 * @param {{label: string, colour: string, dash?: number[], width?: number, points?: boolean}[]} given.series Colours by name.
 * @param {AbortSignal} given.signal
 * @param {number} [given.height] In px.
 * @param {object} [given.options] Further options of uPlot: ``scales``, ``hooks``, ``cursor``, ``axes``.
 * @returns {HTMLElement} With ``update(columns)``, which takes x and one column for each series, and ``plot``.
 */
export function chart({ label, x, series, signal, height = 220, options = {} }) {
  const place = h("div.chart", { role: "img", "aria-label": label });
  let columns = null;
  let drawn = null;

  function draw() {
    drawn?.destroy();
    drawn = null;
    place.plot = null;
    if (columns === null || place.clientWidth === 0) return;
    const axis = {
      stroke: colour("--muted"), grid: { stroke: colour("--line"), width: 1 }, ticks: { stroke: colour("--line"), width: 1 },
      font: "12px system-ui, sans-serif", labelFont: "12px system-ui, sans-serif", labelSize: 18,
    };
    const { axes = [{}, {}], ...more } = options;
    drawn = place.plot = new uPlot({
      width: place.clientWidth, height, ms: 1, scales: { x: { time: false } },
      axes: [{ ...axis, label: x, ...axes[0] }, { ...axis, size: 52, ...axes[1] }],
      series: [{ label: x }, ...series.map((line) => ({
        label: line.label, stroke: colour(line.colour), width: line.width ?? 2, dash: line.dash, spanGaps: true,
        points: { show: line.points ?? false }, ...line.more,
      }))],
      legend: { live: true }, cursor: { drag: { x: false, y: false } }, ...more,
    }, columns, place);
    drawn.over.addEventListener("mouseleave", () => requestAnimationFrame(rest));
    requestAnimationFrame(rest); // after the first drawing, which also sets the legend
  }

  /** Show the latest values in the legend while the pointer is not on the chart. */
  function rest() {
    if (drawn !== null && columns[0].length && (drawn.cursor.left ?? -1) < 0) drawn.setLegend({ idx: columns[0].length - 1 });
  }

  place.update = (next) => {
    const same = columns !== null && next.length === columns.length;
    columns = next;
    if (drawn && same) {
      drawn.setData(columns);
      requestAnimationFrame(rest);
    } else draw();
  };
  const seen = new ResizeObserver(() => {
    if (drawn === null) draw();
    else if (place.clientWidth > 0 && drawn.width !== place.clientWidth) drawn.setSize({ width: place.clientWidth, height });
  });
  seen.observe(place);
  onTheme(draw, signal);
  signal.addEventListener("abort", () => {
    seen.disconnect();
    drawn?.destroy();
  }, { once: true });
  return place;
}

const STEPS = 5;

/**
 * Return rows of means with intervals and single values on one scale from zero; ``update(rows)`` takes rows of ``key``, ``label``, ``colour`` (by name), ``hollow``, ``mean``, ``low``,
 * ``high`` (or null), ``values``.
 *
 * @param {string} label Description; a table next to the chart has the same content.
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

/** ``43.8 [28.7, 58.9]``, as in the report. */
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
