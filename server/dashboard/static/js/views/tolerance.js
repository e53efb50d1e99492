/** The tolerances of a campaign: how gross an error may be before it makes too many drives violate a requirement. */

import { download } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { capital, count, percent, plural, spaced } from "../format.js";
import { loadOnNews } from "../polling.js";
import { link } from "../router.js";
import { matrix } from "../parts/elements.js";
import { said, share } from "./pair/words.js";
import { detectorCheck } from "./tolerance_detector.js";

const COLOURS = 6;

/** Return the card of a campaign's tolerances and a check of detectors against them; ``news(sequence)`` loads them. */
export function toleranceCard(context, id, problems) {
  const about = h("p.hint");
  const words = h("p", { "aria-live": "polite" });
  const unknown = h("p.hint");
  const legend = h("ul.legend", { "aria-label": "Conditions" });
  const panels = h("div.panels.curves");
  const table = toleranceTable(id);
  const falls = h("ul.plain.falls", { "aria-label": "Where a larger error is safer" });
  const baseline = matrix("Drives that violate a requirement without any error", "Drives");
  const save = (format, label) => h("button", { type: "button", onclick: () => context.tell(() => download(
    `campaigns/${id}/tolerance?format=${format}`, `tolerance-${id}.${format}`)) }, label);
  const card = h("section.card.tolerance", { "aria-label": "Tolerances", hidden: true },
    h("div.inline", null, h("h2", null, "Tolerances"), h("div.actions.push", null, save("csv", "CSV"), save("json", "JSON"))),
    about, words, unknown, legend, panels,
    h("h3", null, "Requirements"), table, falls,
    h("h3", null, "Without any error"), baseline,
    detectorCheck(context, id, problems));

  const load = loadOnNews(async () => {
    const read = await context.get(`campaigns/${id}/tolerance`);
    card.hidden = read.simulations === 0;
    text(about, `How severe an error may be before it makes ${percent(read.limit)} of drives violate a requirement that they would have held without it.`);
    text(words, said(read.note));
    text(unknown, [
      read.audited > 0 && `Drives that hold with the most severe error are assumed to hold with milder ones; of ${count(read.audited)} that were simulated nevertheless, ${count(read.leaks)} violated.`,
      read.open > 0 && `Whether the error caused ${plural(read.open, "more violation")} is not known yet.`,
    ].filter(Boolean).join(" "));
    unknown.hidden = read.open + read.audited === 0;
    const groups = grouped(read);
    drawLegend(read);
    const top = ceiling(read);
    keyed(panels, groups.map((cells) => ({ cells, read, top })), ({ cells }) => JSON.stringify(cells[0].choices), panel);
    table.update(read, groups.flat());
    keyed(falls, groups.flat().filter((cell) => cell.fall), (cell) => `${cell.place} ${cell.fall.words}`,
      (cell) => h("li", null, `${name(cell)}; ${cell.condition}: ${cell.fall.words}.`));
    falls.hidden = falls.children.length === 0;
    drawBaseline(read);
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

  function drawBaseline(read) {
    baseline.update(read.conditions.map((condition) => ({ key: condition, head: capital(condition) })), [...byChoices(read.baseline)].map(([key, some]) => ({
      key, label: capital(some[0].choices.map(chosen).filter(Boolean).join("; ")) || "All",
      cells: read.conditions.map((condition) => share(some.find((one) => one.condition === condition)?.share ?? {})),
    })));
  }

  card.news = (news) => load(news);
  return card;
}

/** Return cells by their choices, each list in the order of conditions. */
function grouped(read) {
  const place = (cell) => read.conditions.indexOf(cell.condition);
  return [...byChoices(read.cells).values()].map((cells) => cells.sort((a, b) => place(a) - place(b)));
}

function byChoices(items) {
  const groups = new Map();
  for (const item of items) {
    const key = JSON.stringify(item.choices);
    groups.set(key, [...(groups.get(key) ?? []), item]);
  }
  return groups;
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
    attribute(picture, "aria-label", `${name(cell)}: share of drives in which the error causes a violation, by ${cell.meaning}. Limit of ${percent(read.limit)}: ${cells.map((one) => `${one.condition}: ${tolerated(one)}`).join("; ")}.`);
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

/** ``2.2 s [1.4, 2.8]``; ``no limit to 8.0 s``. */
function tolerated(cell) {
  const { finding, value, low, high } = cell.tolerated;
  if (!isKnown(cell)) return "unknown";
  const falling = cell.curve.magnitude !== null && cell.curve.magnitude.at(-1) < cell.curve.magnitude[0];
  if (finding === "throughout") return `no limit to ${number(cell, 1, true)}`;
  const probably = finding === "undecided" ? "probably " : "";
  const open = value.severity === null;
  const ends = [low, high].map(({ severity }) => (severity === null ? "beyond" : number(cell, severity, open)));
  return `${probably}${open ? "any" : number(cell, value.severity, true)} [${(falling ? ends.reverse() : ends).join(", ")}]`;
}

function toleranceTable(id) {
  const head = h("tr");
  const body = h("tbody");
  const node = h("div.scroll.tall", { tabindex: 0, role: "region", "aria-label": "Table of tolerances" }, h("table.tolerances", null,
    h("caption.read-out", null, "Tolerated magnitude of each error under each condition"), h("thead", null, head), body));
  let known = "";

  function row(cell) {
    const [example] = cell.examples;
    return h("tr", { title: cell.sentence },
      h("th", { scope: "row" }, name(cell)), h("th", { scope: "row" }, cell.condition),
      h("td.tolerated", null, h("span", { "aria-hidden": "true" }, tolerated(cell)), h("span.read-out", null, cell.sentence)),
      h("td.right", null, cell.screened ? `${count(cell.vulnerable)} of ${count(cell.screened)}` : "–"),
      h("td.right", null, count(cell.drives)), h("td.right", null, count(cell.caused)),
      h("td.example", null, example ? [h("a", { href: link("campaigns", id, "solutions", example.number) }, `solution ${example.number}`), h("span.small.muted", null, ` ${number(cell, example.severity, true)}`)] : "–"));
  }

  node.update = (read, cells) => {
    const heads = ["Error", "Condition", `Tolerated, ${percent(read.confidence)} interval`];
    if (known !== heads.join()) {
      known = heads.join();
      replace(head, heads.map((words) => h("th", { scope: "col" }, words)),
        h("th.right", { scope: "col", title: "Drives that violate with the most severe error concerning the same road users, of those simulated with it" }, "Vulnerable"),
        h("th.right", { scope: "col", title: "Drives simulated with this error: of the vulnerable ones, if there was screening" }, "Drives"),
        h("th.right", { scope: "col", title: "Drives in which this error caused a violation" }, "Caused"),
        h("th", { scope: "col", title: "Drive with the smallest error that caused a violation" }, "Mildest example"));
    }
    keyed(body, cells, (cell) => JSON.stringify([cell.place, cell.sentence, cell.drives, cell.caused, cell.examples[0]]), row);
  };
  return node;
}
