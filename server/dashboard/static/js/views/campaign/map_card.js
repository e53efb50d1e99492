/** The card around the map: its data, its colours, the meaning of its axes, and what is selected on it. */

import { Conditional, UNCHANGED } from "../../api.js";
import { attribute, h, replace, text } from "../../dom.js";
import { count, figure, percent, plural, spaced } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { link, rewrite } from "../../router.js";
import { colour, onTheme } from "../../theme.js";
import { outcomeBadge } from "../../parts/elements.js";
import { solutionMap } from "./map.js";

const OWN = [["verdict", "verdict"], ["fitness", "fitness"], ["robustness", "robustness"], ["generation", "generation"]];
const MOST_LISTED = 60;

/**
 * Return the card, which appears with the first result; ``news`` loads new solutions of a search for the boundary or
 * for something else, ``parameters`` offers more colours, ``ring`` marks the results of the search: the numbers of each, two for a pair, best first, and how many there are.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {URLSearchParams} query ``colour`` and ``solution`` of the address.
 */
export function mapCard(context, id, query) {
  const data = new MapData();
  let by = query.get("colour") ?? "verdict";
  let opened = /^\d+$/.test(query.get("solution") ?? "") ? Number(query.get("solution")) : null;
  let chosen = [];
  let results = [];
  let total = 0; // how many results there are: only the best ones have rings
  let aboutBoundary = true; // whether the search is for the boundary: then fitness and p_th mean something

  const tip = h("div.tip", { hidden: true, "aria-hidden": "true" });
  const canvas = solutionMap({ signal: context.signal, hover, open: (i) => open(data.number[i]), hoverRing, openRing, choose });
  const frame = h("div.map-frame", null, canvas, tip);
  const colours = h("select", { id: "map-colour", onchange: () => recolour(colours.value) });
  const lasso = h("button", { type: "button", "aria-pressed": "false", onclick: () => turnLasso() }, "Lasso");
  const legend = h("ul.legend", { "aria-label": "Colours" });
  const about = h("p.hint");
  const panel = h("aside.map-panel", { "aria-label": "Selection on the map", "aria-live": "polite" });
  const button = (words, label, doing) => h("button", { type: "button", "aria-label": label, onclick: doing }, words);
  const tints = h("div.tints.small.muted");
  const card = h("section.card", { "aria-label": "Map", hidden: true },
    h("div.inline", null, h("h2", null, "Map of the search"),
      h("label", { for: "map-colour" }, "Colour"), colours,
      h("div.actions.push", null, lasso, button("+", "Zoom in", () => canvas.zoom(1.5)), button("−", "Zoom out", () => canvas.zoom(1 / 1.5)),
        button("All", "Show all solutions", () => canvas.whole()))),
    h("div.map-body", null, h("div", null, frame, legend, tints, about), panel));

  let offered = null;
  let known = [];
  offer([]);
  explain();

  const load = loadOnNews(async () => {
    await data.load(id, isParameter(by) ? by : "", context.signal);
    draw(); // even without new data: another colour may have been chosen in the meantime
  }, { signal: context.signal, refuse: context.complain });

  function isParameter(name) {
    return !OWN.some(([own]) => own === name);
  }

  /** Offer colours. The list, which may be open, is not rebuilt if only the order has changed. */
  function offer(parameters) {
    known = parameters;
    const own = OWN.filter(([name]) => name !== "fitness" || aboutBoundary || by === "fitness");
    const names = own.length + parameters.map((one) => `${one.component}.${one.parameter}`).sort().join();
    if (names === offered) return;
    offered = names;
    const groups = Map.groupBy?.(parameters, (one) => one.component) ?? new Map([["parameters", parameters]]);
    replace(colours, own.map(([value, words]) => h("option", { value }, words)),
      [...groups].map(([component, some]) => h("optgroup", { label: spaced(component) },
        some.map((one) => h("option", { value: `${one.component}.${one.parameter}` }, one.title || spaced(one.parameter).replace(".", ": "))))));
    if (isParameter(by) && !parameters.some((one) => `${one.component}.${one.parameter}` === by)) {
      colours.append(h("option", { value: by }, by));
    }
    colours.value = by;
  }

  function recolour(name) {
    by = name;
    rewrite({ colour: by === "verdict" ? null : by });
    draw();
    if (isParameter(by)) load(`${last}/${by}`, { atOnce: true });
  }

  let last = "";
  let version = "";

  function draw() {
    card.hidden = data.count === 0;
    if (!data.count) return;
    const colouring = colouringOf();
    canvas.show(data, colouring, { anew: version !== data.version });
    version = data.version;
    const rings = ringed();
    replace(legend, colouring.legend.map((one) => {
      const dot = h("i");
      dot.style.background = one.colour;
      return h("li", null, dot, one.label);
    }), data.told < data.count && h("li", null, h("i.hollow"), `${count(data.count - data.told)} just reported${aboutBoundary ? ", not scored yet" : ""}`),
    rings.length > 0 && h("li", null, h("i.ringed"), ringWords(rings.length, rings[0].at.length > 1 ? "distinct pair" : "distinct boundary solution")));
    tints.hidden = !data.ground;
    if (data.ground) replace(tints, tintWords(data.ground.p_th), h("i.hatched", { "aria-hidden": "true" }), h("span", null, "too few simulations nearby"));
    const { said, drawn, evaluated, explained, across, up, own_axes } = data.about;
    text(about, [
      said,
      drawn < evaluated ? `${count(drawn)} of ${count(evaluated)} solutions are shown.` : `${plural(data.count, "solution")}.`,
      own_axes ? "The axes are the problem's two parameters." : `Similar solutions lie close together; the map preserves ${percent(explained)} of the squared distances.`,
      across && `Horizontal axis: ${across}.`, up && `Vertical axis: ${up}.`,
    ].filter(Boolean).join(" "));
    mark();
  }

  /** Return what the colours of the ground mean; its middle is the boundary, which only a search for it looks for. */
  function tintWords(p_th) {
    const ramp = h("i.ramp", { "aria-hidden": "true" });
    return aboutBoundary
      ? ["Ground, unsafe share nearby: ", h("span", null, "0"), ramp, h("span", null, `1; in its middle the boundary, ${figure(p_th)}`)]
      : ["Ground, unsafe drives nearby: ", h("span", null, "few"), ramp, h("span", null, "many")];
  }

  function colouringOf() {
    if (by === "verdict") return byVerdict(data);
    if (by === "fitness") return byNumber(padded(data.fitness, data.count), { low: 0 });
    if (by === "robustness") return byNumber(data.robustness);
    if (by === "generation") return byNumber(data.told_in, { low: 0 });
    if (data.by?.parameter !== by || data.by.values.length !== data.told) return byVerdict(data);
    const values = padded(data.by.values, data.count);
    return data.by.choices ? byCategory(values, data.by.choices) : byNumber(values, data.by);
  }

  function hover(i, { x, y }) {
    tip.hidden = i === null;
    canvas.classList.toggle("over", i !== null);
    if (i === null) return;
    const fitness = !aboutBoundary ? "" : i < data.told ? `, fitness ${figure(data.fitness[i])}` : ", not scored yet";
    point(`solution ${data.number[i]}: ${data.words(i)}; robustness ${figure(data.robustness[i])}${fitness}`, { x, y });
  }

  function hoverRing(ring, place) {
    tip.hidden = false;
    canvas.classList.add("over");
    const numbers = ring.at.map((i) => data.number[i]);
    point(numbers.length > 1 ? `pair ${ring.place}: solutions ${numbers.join(" and ")}` : `boundary solution ${ring.place}: solution ${numbers[0]}, ${data.words(ring.at[0])}`, place);
  }

  function point(words, { x, y }) {
    text(tip, words);
    const right = x > canvas.clientWidth / 2;
    tip.style.left = right ? "auto" : `${x + 14}px`;
    tip.style.right = right ? `${canvas.clientWidth - x + 14}px` : "auto";
    tip.style.top = `${Math.max(0, y - 10)}px`;
  }

  function turnLasso(on = lasso.getAttribute("aria-pressed") !== "true") {
    attribute(lasso, "aria-pressed", String(on));
    canvas.lasso(on);
  }

  function choose(indices) {
    chosen = indices.map((i) => data.number[i]);
    if (!chosen.length) opened = null;
    turnLasso(false);
    rewrite({ solution: opened });
    mark();
    if (chosen.length) list();
    else explain();
  }

  async function open(number) {
    opened = number;
    rewrite({ solution: number });
    mark();
    const read = await context.tell(() => context.get(`campaigns/${id}/solutions/${number}`));
    if (!read || opened !== number) return;
    replace(panel, h("h3", null, `Solution ${number} `, outcomeBadge(read)),
      h("p", null, read.words),
      h("p.small.muted", null, [
        read.robustness !== null && `robustness ${figure(read.robustness)}`,
        aboutBoundary && read.fitness !== null && `fitness ${figure(read.fitness)}`,
        aboutBoundary && read.neighbours !== null && `${read.unsafe_neighbours} of ${read.neighbours} neighbours unsafe`,
      ].filter(Boolean).join(" · ")),
      h("p", null, h("a.button.primary", { href: link("campaigns", id, "solutions", number) }, "Open and replay")),
      chosen.length > 0 && h("p", null, h("button.quiet", { type: "button", onclick: list }, "Back to the selection")));
  }

  /** Show a pair or a boundary solution whose ring was clicked. */
  function openRing(ring) {
    const numbers = ring.at.map((i) => data.number[i]);
    if (numbers.length === 1) {
      open(numbers[0]);
      return;
    }
    opened = null;
    rewrite({ solution: null });
    mark();
    replace(panel, h("h3", null, `Pair ${ring.place}`),
      h("ul.chosen", null, ring.at.map((i) => h("li", null, h("a", { href: link("campaigns", id, "solutions", data.number[i]) }, `solution ${data.number[i]}`),
        h("span.small.muted", null, ` ${data.words(i)}`)))),
      h("p", null, h("a.button.primary", { href: link("campaigns", id, "pairs", numbers.join("-")) }, "Open the pair")));
  }

  function list() {
    const rows = placed(chosen);
    const unsafe = rows.filter((i) => data.unsafe[i]).length;
    const distance = aboutBoundary ? (i) => data.fitness[i] : (i) => Math.abs(data.robustness[i]);
    const sorted = rows.sort((a, b) => distance(a) - distance(b)).slice(0, MOST_LISTED);
    replace(panel, h("h3", null, `${plural(rows.length, "solution")} selected`),
      h("p.small.muted", null, `${percent(unsafe / rows.length)} unsafe. ${aboutBoundary ? "Closest to the boundary first." : "Smallest robustness, positive or negative, first."}`),
      h("ul.chosen", null, sorted.map((i) => h("li", null,
        h("a", { href: link("campaigns", id, "solutions", data.number[i]) }, `solution ${data.number[i]}`),
        h("span.small.muted", null, ` ${data.words(i)}; ${aboutBoundary ? `fitness ${figure(data.fitness[i])}` : `robustness ${figure(data.robustness[i])}`}`)))),
      rows.length > MOST_LISTED && h("p.hint", null, `and ${count(rows.length - MOST_LISTED)} more`),
      h("p", null, h("button", { type: "button", onclick: () => choose([]) }, "Clear selection")));
  }

  function explain() {
    replace(panel, h("h3", null, "Nothing selected"),
      h("p.small.muted", null, "Click a point for details. Select several with the lasso, or by dragging with Shift held. Drag to pan; click the map first to zoom with the wheel."));
  }

  /** Return how many rings there are, and of how many results if these are not all. */
  function ringWords(number, what) {
    return results.length < total ? `${count(number)} of ${plural(total, what)}, best first` : plural(number, what);
  }

  /** Return the indices of solutions among the points; a thinned map does not have all of them. */
  function placed(numbers) {
    return numbers.map((number) => data.place.get(number)).filter((i) => i !== undefined);
  }

  /** Return the rings whose points are on the map; their numbers are their places in the list of results. */
  function ringed() {
    return results.map((numbers, index) => ({ at: placed(numbers), place: index + 1, all: numbers.length })).filter((one) => one.at.length === one.all);
  }

  function mark() {
    if (!data.place) return;
    canvas.select({ indices: placed(chosen), rings: ringed(), opened: placed([opened])[0] ?? null });
  }

  onTheme(draw, context.signal);
  if (opened !== null) open(opened);
  card.news = (news, { boundary }) => {
    if (boundary !== aboutBoundary) {
      aboutBoundary = boundary;
      offer(known);
    }
    last = news;
    load(isParameter(by) ? `${news}/${by}` : String(news));
  };
  card.parameters = offer;
  card.ring = (numbers, all) => {
    results = numbers;
    total = all;
    draw();
  };
  return card;
}

const STEPS = 24;
// Stops of the viridis map by S. van der Walt and N. Smith (CC0), evenly spaced.
const STOPS = [[68, 1, 84], [65, 68, 135], [42, 120, 142], [34, 168, 132], [122, 209, 81], [253, 231, 37]];
const CATEGORIES = ["#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#999933", "#bbbbbb", "#882255", "#44aa99"];

/**
 * @typedef {object} Colouring
 * @property {Uint8Array} index Index of the colour of each point.
 * @property {string[]} colours
 * @property {{label: string, colour: string}[]} legend
 */

const KINDS = ["held", "other", "violated"];

/** Colour by verdict: what the campaign is about, and solutions that violate another requirement. */
function byVerdict(data) {
  const colours = [colour("--safe"), colour("--other"), colour("--unsafe")];
  const of = data.about.kinds.map((kind) => KINDS.indexOf(kind));
  const counts = [0, 0, 0];
  const index = Uint8Array.from(data.outcome, (outcome) => of[outcome]);
  for (const kind of index) counts[kind] += 1;
  return {
    index, colours,
    legend: KINDS.map((kind, place) => ({ label: `${data.about.kindWords[kind]}: ${count(counts[place])}`, colour: colours[place], shown: place !== 1 || counts[1] > 0 }))
      .filter((one) => one.shown),
  };
}

/** Colour by a number, from lowest to highest; unknown values are grey. */
function byNumber(values, { low = null, high = null, unit = "" } = {}) {
  let least = low ?? Infinity;
  let most = high ?? -Infinity;
  if (low === null || high === null) {
    for (const value of values) {
      if (!Number.isFinite(value)) continue;
      if (low === null && value < least) least = value;
      if (high === null && value > most) most = value;
    }
  }
  const index = new Uint8Array(values.length);
  const range = most - least || 1;
  for (let i = 0; i < values.length; i += 1) {
    index[i] = Number.isFinite(values[i])
      ? Math.max(0, Math.min(STEPS - 1, Math.floor(((values[i] - least) / range) * STEPS))) : STEPS;
  }
  const colours = Array.from({ length: STEPS }, (_, step) => ramp(step / (STEPS - 1)));
  const ends = [least, (least + most) / 2, most].map((value, place) => ({
    label: `${figure(value)}${unit ? ` ${unit}` : ""}`, colour: colours[Math.round((place / 2) * (STEPS - 1))],
  }));
  return { index, colours: [...colours, colour("--pending")], legend: Number.isFinite(least) ? ends : [] };
}

/** Colour by a category. */
function byCategory(values, choices) {
  const index = new Uint8Array(values.length);
  const many = Math.min(choices.length, CATEGORIES.length);
  for (let i = 0; i < values.length; i += 1) {
    index[i] = Number.isFinite(values[i]) ? Math.min(values[i], many - 1) : many;
  }
  const colours = CATEGORIES.slice(0, many);
  const legend = colours.map((own, place) => ({
    label: place === many - 1 && choices.length > many ? "others" : spaced(choices[place]), colour: own,
  }));
  return { index, colours: [...colours, colour("--pending")], legend };
}

function ramp(share) {
  const at = share * (STOPS.length - 1);
  const below = Math.min(STOPS.length - 2, Math.floor(at));
  const mixed = STOPS[below].map((from, channel) => Math.round(from + (STOPS[below + 1][channel] - from) * (at - below)));
  return `rgb(${mixed.join(",")})`;
}

const COLUMNS = { number: Int32Array, told_in: Int32Array, unsafe: Uint8Array, outcome: Uint16Array, robustness: Float32Array, x: Float32Array, y: Float32Array };

/** The points of a campaign in columns: first those that the search has received, of which only new ones are loaded, then reported ones. */
class MapData {
  #conditional = new Conditional();
  #known = Object.fromEntries(Object.entries(COLUMNS).map(([name, Column]) => [name, new Column(0)])); // without reported ones
  version = "";
  /** Number of all points, and of those that the search has received. */
  count = 0;
  told = 0;
  fitness = new Float32Array(0);
  by = null;
  ground = null;
  about = null;

  /** Load new points; returns whether there are any. */
  async load(campaign, parameter, signal) {
    const query = new URLSearchParams();
    if (this.version) {
      query.set("version", this.version);
      query.set("after", this.told);
    }
    if (parameter) query.set("parameter", parameter);
    const read = await this.#conditional.get(`campaigns/${campaign}/map?${query}`, { signal });
    if (read === UNCHANGED) return false;
    this.#take(read);
    return true;
  }

  #take(read) {
    const { reported } = read;
    const columns = { ...reported, told_in: reported.number.map(() => read.generation) };
    for (const name of Object.keys(COLUMNS)) {
      this.#known[name] = joined(this.#known[name], read.first, read[name]);
      this[name] = joined(this.#known[name], this.#known[name].length, columns[name]);
    }
    this.told = this.#known.number.length;
    this.count = this.number.length;
    this.version = read.version;
    this.fitness = Float32Array.from(read.fitness);
    this.by = read.by && { ...read.by, values: Float32Array.from(read.by.values, (value) => value ?? NaN) };
    this.ground = read.ground && { ...read.ground, tint: bytes(read.ground.tint), clarity: bytes(read.ground.clarity) };
    const { generation, evaluated, drawn, explained, across, up, own_axes, outcomes } = read;
    this.about = { said: read.outcomes_in_words, generation, evaluated, drawn, explained, across, up, own_axes, outcomes, kinds: read.outcome_kinds, kindWords: read.kinds };
  }

  /** Return the outcome of a point in words. */
  words(i) {
    return this.about.outcomes[this.outcome[i]];
  }
}

function joined(known, first, more) {
  const whole = new known.constructor(first + more.length);
  whole.set(known.subarray(0, first));
  whole.set(more, first);
  return whole;
}

/** Return values with unknown ones at the end, up to a length. */
function padded(values, length) {
  const whole = new Float32Array(length).fill(NaN);
  whole.set(values);
  return whole;
}

function bytes(written) {
  return Uint8Array.from(atob(written), (letter) => letter.charCodeAt(0));
}
