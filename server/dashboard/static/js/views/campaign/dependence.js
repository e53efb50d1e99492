/** What the verdict depends on: the unsafe share over each parameter, a small picture each. */

import { h, replace } from "../../dom.js";
import { count, figure, percent, spaced } from "../../format.js";
import { sparing } from "../../sparing.js";

const WIDTH = 220;
const HEIGHT = 96;
const LEFT = 8;
const FEW = 12;

/** Return the card; ``news(generation)`` loads what is new, ``known`` is called with the parameters. */
export function dependenceCard(context, id, known) {
  const panels = h("div.panels");
  const all = h("button", { type: "button", hidden: true, onclick: () => { few = Infinity; draw(); } }, "Show all parameters");
  const card = h("section.card", { "aria-label": "What the verdict depends on", hidden: true },
    h("h2", null, "What the verdict depends on"),
    h("p.hint", null, "Share of unsafe solutions by value, with its 95% interval; strongest dependence first (Cramér's V). Grey: no more than chance. A search does not sample evenly: this says where unsafe solutions were found, not how likely they are."),
    panels, all);
  let few = FEW;
  let read = null;

  const load = sparing(async () => {
    read = await context.get(`campaigns/${id}/dependence`);
    card.hidden = read.evaluated === 0;
    known(read.parameters);
    draw();
  }, { signal: context.signal, refuse: context.complain, leastMs: 8_000, share: 0.05 });

  function draw() {
    const overall = read.evaluated ? read.unsafe / read.evaluated : 0;
    const top = ceiling(read.parameters, overall);
    replace(panels, read.parameters.slice(0, few).map((one) => panel(one, overall, top)));
    all.hidden = read.parameters.length <= few;
  }

  card.news = (generation) => load(generation);
  return card;
}

function ceiling(parameters, overall) {
  let top = overall;
  for (const one of parameters) {
    one.counts.forEach((all, place) => {
      if (all >= 15) top = Math.max(top, wilson(one.unsafe[place], all)[1]);
    });
  }
  return Math.min(1, Math.max(0.1, Math.ceil(top * 10) / 10));
}

/** Wilson interval at 95% (Wilson 1927). */
function wilson(hits, all) {
  const z = 1.959964;
  const share = hits / all;
  const centre = share + (z * z) / (2 * all);
  const spread = z * Math.sqrt((share * (1 - share)) / all + (z * z) / (4 * all * all));
  return [(centre - spread) / (1 + (z * z) / all), (centre + spread) / (1 + (z * z) / all)];
}

function panel(one, overall, top) {
  const groups = one.places.map((at, place) => ({ at, all: one.counts[place], hits: one.unsafe[place], label: one.labels[place] })).filter((group) => group.all > 0);
  const scale = one.low !== null && !one.labels.length;
  const [low, high] = scale ? [one.low, one.high] : [-0.5, one.places.length - 0.5];
  const first = one.labels.length && !scale ? one.places[0] : 0;
  const x = (at) => LEFT + ((at - (scale ? 0 : first) - low) / (high - low || 1)) * (WIDTH - 2 * LEFT);
  const y = (share) => HEIGHT - 4 - (Math.min(share, top) / top) * (HEIGHT - 12);
  const colour = one.detectable ? "var(--unsafe)" : "var(--pending)";
  const name = `${spaced(one.parameter).replace(".", ": ")}`;
  const words = groups.map((group) => `${group.label ?? figure(group.at)}: ${percent(group.hits / group.all)} of ${group.all}`).join("; ");
  const picture = h("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${name}. Unsafe: ${words}.` },
    h("line", { x1: 0, x2: WIDTH, y1: y(overall), y2: y(overall), stroke: "var(--muted)", "stroke-width": 1, "stroke-dasharray": "3 3" }),
    groups.map((group) => {
      const [from, to] = wilson(group.hits, group.all);
      return h("line", { x1: x(group.at), x2: x(group.at), y1: y(from), y2: y(to), stroke: colour, "stroke-width": 3, opacity: 0.45 });
    }),
    !one.labels.length && h("polyline", { points: groups.map((group) => `${x(group.at)},${y(group.hits / group.all)}`).join(" "), fill: "none", stroke: colour, "stroke-width": 1.4 }),
    groups.map((group) => h("circle", { cx: x(group.at), cy: y(group.hits / group.all), r: 3.6, fill: colour })));
  const ends = one.labels.length ? [groups[0]?.label, groups.length > 1 && groups.at(-1)?.label] : [figure(low), `${figure(high)} ${one.unit}`];
  return h("figure.panel", null,
    h("figcaption", null, h("strong", null, name), h("span.small.muted", null, ` V ${figure(one.strength, 2)}, ${count(groups.reduce((sum, group) => sum + group.all, 0))}`)),
    h("div.plot", null, h("span.top.small.muted", { "aria-hidden": "true" }, percent(top)), picture),
    one.labels.length && groups.length <= 6
      ? h("div.groups.small.muted", { "aria-hidden": "true" }, groups.map((group) => h("span", null, group.label)))
      : h("div.ends.small.muted", { "aria-hidden": "true" }, ends.map((words) => h("span", null, words || ""))));
}
