/** The map with what belongs to it: how it is coloured, what the axes mean, which solutions are chosen. */

import { attribute, h, replace, text } from "../../dom.js";
import { count, figure, percent, plural, spaced } from "../../format.js";
import { badge } from "../../parts/badge.js";
import { sparing } from "../../sparing.js";
import { link, rewrite } from "../../router.js";
import { onTheme } from "../../theme.js";
import { solutionMap } from "./map.js";
import { byCategory, byFigure, byVerdict } from "./map_colours.js";
import { MapData } from "./map_data.js";

const OWN = [["verdict", "verdict"], ["fitness", "fitness"], ["robustness", "robustness"], ["generation", "generation"]];
const MOST_LISTED = 60;

/**
 * Return the card; its ``news`` loads what is new, its ``parameters`` offers more colours, its ``ring`` takes the numbers of
 * the boundary solutions.
 *
 * @param {Context} context
 * @param {string} id The campaign.
 * @param {URLSearchParams} query ``colour`` and ``solution`` of the address.
 */
export function mapCard(context, id, query) {
  const data = new MapData();
  let by = query.get("colour") ?? "verdict";
  let opened = /^\d+$/.test(query.get("solution") ?? "") ? Number(query.get("solution")) : null;
  let chosen = [];
  let boundary = [];

  const tip = h("div.tip", { hidden: true, "aria-hidden": "true" });
  const canvas = solutionMap({ signal: context.signal, hover, open: (i) => open(data.number[i]), choose });
  const frame = h("div.map-frame", null, canvas, tip);
  const colours = h("select", { id: "map-colour", onchange: () => recolour(colours.value) });
  const lasso = h("button", { type: "button", "aria-pressed": "false", onclick: () => turnLasso() }, "Lasso");
  const legend = h("ul.legend", { "aria-label": "Colours" });
  const about = h("p.hint");
  const panel = h("aside.map-panel", { "aria-label": "Chosen on the map", "aria-live": "polite" });
  const button = (words, label, doing) => h("button", { type: "button", "aria-label": label, onclick: doing }, words);
  const card = h("section.card", { "aria-label": "Map" },
    h("div.inline", null, h("h2", null, "Map of the search"),
      h("label", { for: "map-colour" }, "Colour"), colours,
      h("div.actions.push", null, lasso, button("+", "Zoom in", () => canvas.zoom(1.5)), button("−", "Zoom out", () => canvas.zoom(1 / 1.5)),
        button("All", "Show all solutions", () => canvas.whole()))),
    h("div.map-body", null, h("div", null, frame, legend, about), panel));

  let offered = null;
  offer([]);
  explain();

  const load = sparing(async () => {
    await data.load(id, isParameter(by) ? by : "", context.signal);
    draw(); // even if nothing came: colours may have been chosen meanwhile
  }, { signal: context.signal, refuse: context.complain });

  function isParameter(name) {
    return !OWN.some(([own]) => own === name);
  }

  /** Offer colours; a list that somebody may have open is not made anew only because the order has changed. */
  function offer(parameters) {
    const names = parameters.map((one) => `${one.component}.${one.parameter}`).sort().join();
    if (names === offered) return;
    offered = names;
    const groups = Map.groupBy?.(parameters, (one) => one.component) ?? new Map([["parameters", parameters]]);
    replace(colours, OWN.map(([value, words]) => h("option", { value }, words)),
      [...groups].map(([component, some]) => h("optgroup", { label: spaced(component) },
        some.map((one) => h("option", { value: `${one.component}.${one.parameter}` }, spaced(one.parameter).replace(".", ": "))))));
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
    if (!data.count) {
      text(about, "No solution has a verdict yet.");
      return;
    }
    const colouring = colouringOf();
    canvas.show(data, colouring, { anew: version !== data.version });
    version = data.version;
    replace(legend, colouring.legend.map((one) => {
      const dot = h("i");
      dot.style.background = one.colour;
      return h("li", null, dot, one.label);
    }), boundary.length > 0 && h("li", null, h("i.ringed"), `${plural(placed(boundary).length, "distinct boundary solution")}, ringed`));
    const { drawn, evaluated, explained, across, up } = data.about;
    text(about, [
      drawn < evaluated ? `${count(drawn)} of ${count(evaluated)} solutions are drawn.` : `${plural(drawn, "solution")}.`,
      `Alike ones lie near each other; the plane holds ${percent(explained)} of the spread.`,
      across && `Across: ${across}.`, up && `Up: ${up}.`,
    ].filter(Boolean).join(" "));
    mark();
  }

  function colouringOf() {
    if (by === "verdict") return byVerdict(data);
    if (by === "fitness") return byFigure(data.fitness, { low: 0 });
    if (by === "robustness") return byFigure(data.robustness);
    if (by === "generation") return byFigure(data.told_in, { low: 0 });
    if (data.by?.parameter !== by || data.by.values.length !== data.count) return byVerdict(data);
    return data.by.choices ? byCategory(data.by.values, data.by.choices) : byFigure(data.by.values, data.by);
  }

  function hover(i, { x, y }) {
    tip.hidden = i === null;
    canvas.classList.toggle("over", i !== null);
    if (i === null) return;
    text(tip, `solution ${data.number[i]}: ${data.unsafe[i] ? "unsafe" : "safe"}, robustness ${figure(data.robustness[i])}, fitness ${figure(data.fitness[i])}`);
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
    replace(panel, h("h3", null, `Solution ${number} `, badge(read.verdict)),
      h("p", null, read.words),
      h("p.small.muted", null, [
        read.robustness !== null && `robustness ${figure(read.robustness)}`,
        read.fitness !== null && `fitness ${figure(read.fitness)}`,
        read.neighbours !== null && `${read.unsafe_neighbours} of ${read.neighbours} around it unsafe`,
      ].filter(Boolean).join(" · ")),
      h("p", null, h("a.button.primary", { href: link("campaigns", id, "solutions", number) }, "Open and replay")),
      chosen.length > 0 && h("p", null, h("button.quiet", { type: "button", onclick: list }, "Back to the chosen ones")));
  }

  function list() {
    const rows = placed(chosen);
    const unsafe = rows.filter((i) => data.unsafe[i]).length;
    const sorted = rows.sort((a, b) => data.fitness[a] - data.fitness[b]).slice(0, MOST_LISTED);
    replace(panel, h("h3", null, `${plural(rows.length, "solution")} chosen`),
      h("p.small.muted", null, `${percent(unsafe / rows.length)} unsafe. The nearest to the boundary first.`),
      h("ul.chosen", null, sorted.map((i) => h("li", null,
        h("a", { href: link("campaigns", id, "solutions", data.number[i]) }, `solution ${data.number[i]}`),
        h("span.small.muted", null, ` ${data.unsafe[i] ? "unsafe" : "safe"}, fitness ${figure(data.fitness[i])}`)))),
      rows.length > MOST_LISTED && h("p.hint", null, `and ${count(rows.length - MOST_LISTED)} more`),
      h("p", null, h("button", { type: "button", onclick: () => choose([]) }, "Choose none")));
  }

  function explain() {
    replace(panel, h("h3", null, "Nothing chosen"),
      h("p.small.muted", null, "Click a point to see what it is. Draw around some with the lasso, or with Shift held. Drag to move; click the map once and the wheel zooms."));
  }

  /** Return where solutions are among the points; a thinned map has not all of them. */
  function placed(numbers) {
    return numbers.map((number) => data.place.get(number)).filter((i) => i !== undefined);
  }

  function mark() {
    if (!data.place) return;
    canvas.select({ indices: placed(chosen), boundary: placed(boundary), opened: placed([opened])[0] ?? null });
  }

  onTheme(draw, context.signal);
  if (opened !== null) open(opened);
  card.news = (generation) => {
    last = generation;
    load(isParameter(by) ? `${generation}/${by}` : String(generation));
  };
  card.parameters = offer;
  card.ring = (numbers) => {
    boundary = numbers;
    draw();
  };
  return card;
}
