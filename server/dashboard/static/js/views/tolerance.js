/** The tolerances of a campaign: how gross an error may be before it makes too many drives violate a requirement. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { capital, percent, spaced } from "../format.js";
import { loadOnNews } from "../polling.js";
import { detectorCheck } from "./tolerance_detector.js";

const COLOURS = 6;

/** Return the curves of a campaign's tolerances, to stand above their tables, and a check of detectors against them, below. */
export function toleranceCurves(context, id) {
  const legend = h("ul.legend", { "aria-label": "Conditions" });
  const panels = h("div.panels.curves");

  const load = loadOnNews(async () => {
    const read = await context.get(`campaigns/${id}/tolerance`);
    drawLegend(read);
    const top = ceiling(read);
    keyed(panels, grouped(read).map((cells) => ({ cells, read, top })), ({ cells }) => JSON.stringify(cells[0].choices), panel);
  }, { signal: context.signal, refuse: context.complain, leastMs: 3_000, share: 0.2 });

  function drawLegend(read) {
    const items = [
      ...read.conditions.map((condition, place) => [condition, h(`i.key.line${place < COLOURS ? "" : ".dotted"}`, { style: { "--of": colourOf(place) } })]),
      [`${percent(read.confidence)} interval`, h("i.key.interval-band")],
      [`limit, ${percent(read.limit)} of drives`, h("i.key.limit")],
      ["limit reached", h("i.reached")],
      ["limit probably reached", h("i.reached.hollow")],
    ];
    keyed(legend, items, ([label]) => label, ([label, key]) => h("li", null, key, label));
  }

  return {
    above: h("div.tolerance", null, legend, panels),
    below: detectorCheck(context, id),
    update: (finding) => load(JSON.stringify([finding.sentence, finding.tables[0].rows])),
  };
}

/** Return cells by their choices, each list in the order of conditions. */
function grouped(read) {
  const place = (cell) => read.conditions.indexOf(cell.condition);
  const groups = new Map();
  for (const cell of read.cells) {
    const key = JSON.stringify(cell.choices);
    groups.set(key, [...(groups.get(key) ?? []), cell]);
  }
  return [...groups.values()].map((cells) => cells.sort((a, b) => place(a) - place(b)));
}

/** ``target: lead``. */
function chosen(choices) {
  return Object.entries(choices).map(([parameter, value]) => `${shortName(parameter)}: ${spaced(value)}`).join(", ");
}

function shortName(parameter) {
  return spaced(parameter.split(".").at(-1));
}

/** Return whether anything was simulated of a cell; screening alone may say that it tolerates any error. */
function isKnown(cell) {
  return cell.drives + cell.screened > 0;
}

/** ``Not reporting the lead for …``. */
function name(cell) {
  return capital(cell.error);
}

function colourOf(place) {
  return `var(--condition-${(place % COLOURS) + 1})`;
}

/** Return the greatest share that all panels show. */
function ceiling(read) {
  const most = Math.max(2 * read.limit, ...read.cells.flatMap((cell) => cell.curve.share));
  return Math.min(1, Math.max(0.1, Math.ceil(most * 10 - 1e-9) / 10));
}

const WIDTH = 260;
const HEIGHT = 130;
const MARGIN = 6;

/** Return the curves of the cells that have the same choices; ``update`` draws later ones. */
function panel(first) {
  const heading = h("strong");
  const axis = h("div.shares.small.muted", { "aria-hidden": "true" });
  const picture = h("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  const ends = h("div.ends.small.muted", { "aria-hidden": "true" });
  const meaning = h("div.meaning.small.muted", { "aria-hidden": "true" });
  const node = h("figure.panel", null, h("figcaption", null, heading), h("div.plot", null, axis, picture, h("span"), ends, h("span"), meaning));
  let drawn = "";

  node.update = (given) => {
    const told = JSON.stringify([given.cells.map(({ curve, tolerated }) => [curve, tolerated]), given.top, given.read.limit]);
    if (told === drawn) return;
    drawn = told;
    const { cells, read, top } = given;
    const [cell] = cells;
    text(heading, name(cell));
    attribute(node, "title", chosen(cell.choices));
    replace(axis, [top, top / 2, 0].map((at) => h("span", null, percent(at))));
    replace(ends, [0, 0.5, 1].map((severity) => h("span", null, number(cell, severity, severity === 1))));
    text(meaning, cell.meaning);
    attribute(picture, "aria-label", `${name(cell)}: share of drives in which the error causes a violation, by ${cell.meaning}. Limit of ${percent(read.limit)}: ${cells.map((one) => `${one.condition}: ${one.tolerated_words}`).join("; ")}.`);
    replace(picture, curves(cells, read, top));
  };
  node.update(first);
  return node;
}

function curves(cells, read, top) {
  const x = (severity) => MARGIN + severity * (WIDTH - 2 * MARGIN);
  const y = (at) => HEIGHT - 1 - (at / top) * (HEIGHT - 2);
  const points = (severity, values) => values.map((value, place) => `${x(severity[place]).toFixed(1)},${y(value).toFixed(1)}`);
  const line = (given) => h("line", { "vector-effect": "non-scaling-stroke", ...given });
  const across = (at, more) => line({ x1: 0, x2: WIDTH, y1: y(at), y2: y(at), ...more });
  const known = cells.filter(isKnown).map((cell) => {
    const place = read.conditions.indexOf(cell.condition);
    return { ...cell, colour: colourOf(place), dotted: place >= COLOURS };
  });
  return [
    [0, 0.5, 1].map((part) => across(part * top, { stroke: "var(--line)" })),
    [0, 0.5, 1].map((part) => line({ x1: x(part), x2: x(part), y1: 0, y2: HEIGHT, stroke: "var(--line)" })),
    known.map(({ curve, colour }) => h("path", {
      d: `M${[...points(curve.severity, curve.high), ...points(curve.severity, curve.low).reverse()].join("L")}Z`, fill: colour, opacity: 0.13,
    })),
    across(read.limit, { stroke: "var(--ink)", "stroke-width": 1.2, "stroke-dasharray": "5 4" }),
    known.map(({ curve, colour, dotted }) => h("polyline", {
      points: points(curve.severity, curve.share).join(" "), fill: "none", stroke: colour, "stroke-width": 2, "vector-effect": "non-scaling-stroke",
      "stroke-dasharray": dotted ? "2 3" : null,
    })),
    known.filter((cell) => cell.tolerated.value.severity !== null).map(({ tolerated: { finding, value }, colour }) => h("circle", {
      cx: x(value.severity), cy: y(read.limit), r: 4, fill: finding === "limit" ? colour : "var(--card)", stroke: finding === "limit" ? "var(--card)" : colour, "stroke-width": finding === "limit" ? 1 : 2,
    })),
  ];
}

/** Return the magnitude of a severity in digits: as the cell's sentence does, or the severity itself without a scale. */
function number(cell, severity, unit = false) {
  const { magnitude } = cell.curve;
  if (magnitude === null) return severity.toFixed(2);
  const digits = (magnitude[0] + severity * (magnitude.at(-1) - magnitude[0])).toFixed(cell.decimals);
  return unit ? `${digits}${cell.unit === "%" ? "" : " "}${cell.unit}`.trim() : digits;
}
