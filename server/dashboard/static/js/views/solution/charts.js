/** Charts of an episode over time: the boxes in the camera's picture, the robustness of each requirement, and the guard. */

import { h, text } from "../../dom.js";
import { figure, plainId, spaced } from "../../format.js";
import { colour } from "../../theme.js";
import { canvas, chart } from "../../parts/charts.js";
import { segments } from "../../parts/elements.js";
import { BOLD, drawLine, FONT, palette, writeHaloed } from "./drawing.js";
import { eachRow, guardSpans, rowCount } from "./episode.js";

const PERSON = 1;
const [LEFT_PX, RIGHT_PX, TOP_PX, BOTTOM_PX] = [52, 10, 8, 38];
const NAMED_SHARE = 0.04;
/** Of the episode: shorter bands are not named. */
const CROWDED = 12;
/** More bands than this are drawn faintly. */
const FILTERS = [["", "All"], ["1", "People"], ["0", "Vehicles"]];
const LEAST_OVERLAP = 0.2;
const MISSED_SAMPLES = 2;
/** A band survives at most this many samples without a box. */
const EDGE = 5;
/** Robustness beyond this is drawn at the edge: only values near zero matter. */
const SERIES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];
const DASHES = [undefined, [8, 4], [2, 3], [10, 3, 2, 3]];

/** Return the chart of the boxes in a player's episode as bands over time; null if there are no boxes. */
export function boxes(player) {
  const { episode, signal } = player;
  const { data } = episode;
  const { report } = episode.words;
  if (rowCount(data.seen) + rowCount(data.given) === 0) return null;
  const colours = palette();
  const every = { seen: bands(data.seen, episode.times.length), given: bands(data.given, episode.times.length) };
  const present = new Set([...every.seen, ...every.given].map(({ label }) => label));
  let { seen, given, crowded } = filtered("");
  const wide_px = episode.camera.width_px;
  const cursor = h("i.time-cursor", { "aria-hidden": "true" });
  let area = null;
  let named = [];

  const sheet = canvas({
    label: `Boxes in the picture over time: ground truth and ${report}`, ratio: 4, least: 220, most: 320, signal,
    recolour: colours.renew, draw,
  });
  const filters = present.size < 2 ? null : segments("Boxes shown", choose, FILTERS, "");
  if (filters && crowded) choose(firstFilter());
  sheet.append(cursor);
  sheet.classList.add("seekable");

  /** Return the filter of a crowded chart: the label of the injected boxes, or people for a detector. */
  function firstFilter() {
    if (report !== "injected") return String(PERSON);
    const labels = new Set(every.given.map(({ label }) => label));
    return labels.size === 1 ? String([...labels][0]) : "";
  }

  function filtered(label) {
    const of = (all) => (label === "" ? all : all.filter((band) => band.label === Number(label)));
    const [truth, reported] = [of(every.seen), of(every.given)];
    return { seen: truth, given: reported, crowded: truth.length + reported.length > CROWDED };
  }

  function choose(label) {
    ({ seen, given, crowded } = filtered(label));
    filters.update(FILTERS, label);
    sheet.redraw();
  }

  function x(time_s) {
    return area.left + ((time_s - episode.start_s) / Math.max(1e-6, episode.end_s - episode.start_s)) * area.width;
  }

  function y(column_px) {
    return area.top + area.height * (1 - column_px / wide_px);
  }

  function draw(pen, width, height) {
    area = { left: LEFT_PX, top: TOP_PX, width: width - LEFT_PX - RIGHT_PX, height: height - TOP_PX - BOTTOM_PX };
    pen.clearRect(0, 0, width, height);
    drawAxes(pen, width, height);
    pen.save();
    pen.beginPath();
    pen.rect(area.left, area.top, area.width, area.height);
    pen.clip();
    for (const band of seen) drawBand(pen, band, false);
    for (const band of given) drawBand(pen, band, true);
    named = [];
    for (const band of [...given].sort((a, b) => b.label - a.label || b.samples.length - a.samples.length)) name(pen, band);
    pen.restore();
    placeCursor();
  }

  function drawAxes(pen, width, height) {
    pen.strokeStyle = colours.line;
    pen.fillStyle = colours.muted;
    pen.lineWidth = 1;
    pen.font = FONT;
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let column = 0; column <= wide_px; column += wide_px / 4) {
      drawLine(pen, area.left, y(column), area.left + area.width, y(column));
      pen.fillText(String(Math.round(column)), area.left - 6, y(column));
    }
    pen.textAlign = "center";
    pen.textBaseline = "top";
    const step_s = [0.2, 0.5, 1, 2, 5, 10, 30, 60, 300].find((step) => (x(step) - x(0)) >= 44) ?? 600;
    for (let time_s = Math.ceil(episode.start_s / step_s) * step_s; time_s <= episode.end_s + 1e-6; time_s += step_s) {
      drawLine(pen, x(time_s), area.top, x(time_s), area.top + area.height);
      pen.fillText(String(Number(time_s.toFixed(1))), x(time_s), area.top + area.height + 4);
    }
    pen.fillText("time, s", area.left + area.width / 2, height - 16);
    pen.save();
    pen.translate(8, area.top + area.height / 2);
    pen.rotate(-Math.PI / 2);
    pen.textBaseline = "middle";
    pen.fillText("column, px", 0, 0);
    pen.restore();
  }

  function drawBand(pen, { label, samples, low, high }, reported) {
    const times = [...samples, Math.min(episode.last, samples.at(-1) + 1)].map((sample) => episode.times[sample]);
    const [under, over] = [[...low, low.at(-1)], [...high, high.at(-1)]];
    pen.beginPath();
    times.forEach((time_s, index) => (index ? pen.lineTo(x(time_s), y(over[index])) : pen.moveTo(x(time_s), y(over[index]))));
    for (let index = times.length - 1; index >= 0; index -= 1) pen.lineTo(x(times[index]), y(under[index]));
    pen.closePath();
    pen.fillStyle = reported ? colours.injected : label === PERSON ? colours.pedestrian : colours.vehicle;
    pen.globalAlpha = (reported ? 0.12 : 0.32) / (crowded ? 2 : 1);
    pen.fill();
    pen.globalAlpha = 1;
    pen.strokeStyle = reported ? colours.injected : colours.seen;
    pen.lineWidth = reported && !crowded ? 2 : 1;
    if (reported) pen.setLineDash([6, 4]);
    pen.stroke();
    pen.setLineDash([]);
  }

  /** Label a band at its start unless it is short or another label is in the way: people and long bands come first. */
  function name(pen, { label, samples, low, high }) {
    if (samples.length < Math.max(4, NAMED_SHARE * episode.last)) return;
    const word = episode.byLabel("labels", label);
    pen.font = BOLD;
    const wide = pen.measureText(word).width;
    const left = Math.min(x(episode.times[samples[0]]) + 5, area.left + area.width - wide - 4);
    const middle = y((low[0] + high[0]) / 2);
    if (named.some((other) => left < other.left + other.wide + 6 && other.left < left + wide + 6 && Math.abs(other.middle - middle) < 15)) return;
    named.push({ left, wide, middle });
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    writeHaloed(pen, word, left, middle, colours.injected, colours.paper);
  }

  function placeCursor() {
    if (!area) return;
    cursor.style.left = `${x(player.time_s)}px`;
    cursor.style.top = `${area.top}px`;
    cursor.style.height = `${area.height}px`;
  }

  function seek(event) {
    if (!area || (event.type === "pointermove" && !(event.buttons & 1))) return;
    const left = event.clientX - sheet.getBoundingClientRect().left;
    player.seek(episode.start_s + ((left - area.left) / area.width) * (episode.end_s - episode.start_s));
  }

  sheet.addEventListener("pointerdown", seek);
  sheet.addEventListener("pointermove", seek);
  player.listen((_, changed) => changed.time && placeCursor());

  return h("section.card", { "aria-label": "Boxes over time" },
    h("div.inline", null, h("h2", null, "Boxes in the picture over time"), filters), sheet,
    h("ul.legend", null, every.seen.some(({ label }) => label !== PERSON) && h("li", null, h("i.key.band.vehicle"), "vehicle (ground truth)"),
      every.seen.some(({ label }) => label === PERSON) && h("li", null, h("i.key.band.pedestrian"), "person (ground truth)"),
      rowCount(data.given) > 0 && h("li", null, h("i.key.given.dashed"), `${report}: reported to the driving system`)),
    h("p.hint", null, "The vertical axis runs from the left edge of the picture to its right edge. Click to jump to a time."));
}

/**
 * Return boxes of successive samples that overlap, joined to bands of horizontal position over time.
 *
 * @param {object} rows Rows of boxes of an episode.
 * @param {number} samples
 * @returns {{label: number, samples: number[], low: number[], high: number[]}[]} In order of the first sample.
 */
function bands(rows, samples) {
  const found = [];
  let open = [];
  for (let sample = 0; sample < samples; sample += 1) {
    const taken = new Set();
    eachRow(rows, sample, (row, columns) => {
      const box = {
        label: columns.label[row], low: columns.x_min_px[row], high: columns.x_max_px[row],
        top: columns.y_min_px[row], bottom: columns.y_max_px[row],
      };
      if (box.low === null || box.high === null) return;
      let best = null;
      let most = LEAST_OVERLAP;
      for (const band of open) {
        if (band.label !== box.label || taken.has(band)) continue;
        const shared = overlap(band.last, box);
        if (shared >= most) [best, most] = [band, shared];
      }
      if (best === null) {
        best = { label: box.label, samples: [], low: [], high: [] };
        found.push(best);
        open.push(best);
      }
      taken.add(best);
      best.last = box;
      best.samples.push(sample);
      best.low.push(box.low);
      best.high.push(box.high);
    });
    open = open.filter((band) => band.samples.at(-1) >= sample - MISSED_SAMPLES);
  }
  return found;
}

/** Return the intersection of two boxes over their union. */
function overlap(a, b) {
  const wide = Math.min(a.high, b.high) - Math.max(a.low, b.low);
  const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
  if (wide <= 0 || high <= 0) return 0;
  const both = wide * high;
  const area = (box) => (box.high - box.low) * (box.bottom - box.top);
  return both / (area(a) + area(b) - both);
}

/** Return the chart of robustness over time, a line per requirement; null if no requirement is recorded. */
export function robustness(player) {
  const { episode } = player;
  const { robustness: recorded, units } = episode.data;
  const judged = episode.story?.requirement;
  const names = Object.keys(recorded).sort((a, b) => (b === judged) - (a === judged));
  if (names.length === 0) return null;
  const near = names.filter((name, index) => index === 0 || recorded[name].some((value) => value !== null && value < EDGE));
  const far = names.filter((name) => !near.includes(name));
  const least = Math.min(0, ...near.map((name) => recorded[name].reduce((low, value) => (value === null ? low : Math.min(low, value)), 0)));
  const floor = Math.max(-EDGE, Math.min(-1, 1.1 * least));
  const clipped = (value) => (value === null ? null : Math.max(floor, Math.min(EDGE, value)));

  const node = overTime(player, {
    label: "Robustness of each requirement over time", axis: "robustness", range: [floor, EDGE], height: 260,
    lines: near.map((name, index) => ({
      label: withUnit(name, units[name]), colour: SERIES[index % SERIES.length], width: name === judged ? 2.5 : 1.5,
      dash: DASHES[Math.floor(index / SERIES.length) % DASHES.length] ?? (index ? DASHES[index % DASHES.length] : undefined),
      values: recorded[name].map(clipped), exact: recorded[name],
    })),
    ground(plot) {
      const { ctx, bbox } = plot;
      const zero = plot.valToPos(0, "y", true);
      ctx.fillStyle = colour("--bad-ground");
      ctx.fillRect(bbox.left, zero, bbox.width, bbox.top + bbox.height - zero);
      ctx.fillStyle = colour("--bad");
      ctx.fillRect(bbox.left, zero - 1, bbox.width, 2);
    },
  });
  const note = h("p.hint");
  text(note, [
    "Distance to violation, in the unit of each requirement; below zero the requirement is violated.",
    `Values beyond ±${EDGE} are drawn at the edge.`,
    far.length > 0 && `Always above ${EDGE}: ${far.map((name) => spaced(plainId(name))).join(", ")}.`,
    "Click to jump to a time.",
  ].filter(Boolean).join(" "));
  return h("section.card", { "aria-label": "Robustness over time" }, h("h2", null, "Robustness over time"), node, note);
}

/** Return the chart of a guard's probabilities over time, with its alarms; null for a car without a guard. */
export function guard(player) {
  const { episode } = player;
  const { guard: recorded } = episode.data;
  if (!recorded) return null;
  const spans = guardSpans(episode);
  const node = overTime(player, {
    label: "The guard's probability of a violation over time", axis: "probability", range: [0, 1], height: 200,
    lines: recorded.horizons_s.map((horizon_s, index) => ({
      label: `within ${horizon_s} s`, colour: SERIES[index % SERIES.length], width: 1.5, dash: DASHES[index % DASHES.length],
      values: recorded.probabilities[index], exact: recorded.probabilities[index],
    })),
    ground(plot) {
      const { ctx, bbox } = plot;
      ctx.globalAlpha = 0.35;
      for (const { state, first, last } of spans) {
        const left = plot.valToPos(episode.times[first], "x", true);
        ctx.fillStyle = colour(`--guard-${state}`);
        ctx.fillRect(left, bbox.top, plot.valToPos(episode.times[last], "x", true) - left, bbox.height);
      }
    },
  });
  return h("section.card", { "aria-label": "Guard over time" }, h("h2", null, "Guard over time"), node,
    h("ul.legend", null, h("li", null, h("i.key.alarm"), "alarm"), h("li", null, h("i.key.fallback"), `fallback ${recorded.fallback} intervenes`)),
    h("p.hint", null, "The guard's estimate of the probability of a violation within each of its horizons. Click to jump to a time."));
}

/**
 * Return a line chart over the time of an episode, with a cursor at the time that is shown; a click jumps to a time.
 *
 * @param {Player} player
 * @param {object} given
 * @param {string} given.label Description for screen readers.
 * @param {string} given.axis Name of the vertical axis.
 * @param {[number, number]} given.range Of the vertical axis.
 * @param {number} given.height In px.
 * @param {object[]} given.lines As series of `chart`, with ``values`` to draw and ``exact`` ones for the legend.
 * @param {(plot: object) => void} given.ground Draws what lies behind the lines.
 */
function overTime(player, { label, axis, range, height, lines, ground }) {
  const { episode, signal } = player;
  const cursor = h("i.time-cursor", { "aria-hidden": "true" });
  const node = chart({
    label, x: "time, s", signal, height,
    series: lines.map(({ values, exact, ...line }) => ({
      ...line, more: { value: (_, __, ___, at) => (at === null || at === undefined ? "–" : figure(exact[at])) },
    })),
    options: {
      scales: { x: { time: false }, y: { range } },
      axes: [{}, { label: axis }],
      cursor: { drag: { x: false, y: false }, y: false },
      hooks: {
        drawClear: [(plot) => {
          plot.ctx.save();
          ground(plot);
          plot.ctx.restore();
        }],
        ready: [(plot) => {
          plot.over.append(cursor);
          plot.over.addEventListener("pointerdown", (event) => seek(plot, event));
          plot.over.addEventListener("pointermove", (event) => event.buttons & 1 && seek(plot, event));
          plot.over.addEventListener("pointerleave", () => follow(plot));
          follow(plot);
        }],
        setSize: [(plot) => requestAnimationFrame(() => follow(plot))],
      },
    },
  });
  node.classList.add("seekable");

  function seek(plot, event) {
    player.seek(plot.posToVal(event.clientX - plot.over.getBoundingClientRect().left, "x"));
  }

  /** Move the cursor to the time that is shown, and show its values in the legend unless the pointer is over the chart. */
  function follow(plot, values = true) {
    if (!plot || signal.aborted) return;
    cursor.style.left = `${plot.valToPos(player.time_s, "x")}px`;
    if (values && !plot.over.matches(":hover")) plot.setLegend({ idx: player.sample });
  }

  player.listen((_, changed) => changed.time && follow(node.plot, changed.sample));
  node.update([episode.times, ...lines.map(({ values }) => values)]);
  return node;
}

function withUnit(requirement, unit) {
  return unit ? `${spaced(plainId(requirement))}, ${unit}` : spaced(plainId(requirement));
}
