/** Cards of a campaign: parameter dependence, repeats, settings. */

import { h, replace, text } from "../../dom.js";
import { capital, count, figure, percent, plural, spaced } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { link } from "../../router.js";
import { badge } from "../../parts/elements.js";

const WIDTH = 220;
const HEIGHT = 96;
const LEFT = 8;
const FEW = 12;
/** Groups with fewer solutions are drawn hollow, and do not set the scale. */
const LEAST = 15;

/** Return the card of parameter dependence; ``news(generation)`` loads it, ``known`` is called with the parameters. */
export function dependenceCard(context, id, known) {
  const panels = h("div.panels.dependence");
  const all = h("button", { type: "button", hidden: true, onclick: () => { few = Infinity; draw(); } }, "Show all parameters");
  const card = h("section.card", { "aria-label": "Parameter dependence", hidden: true },
    h("h2", null, "Parameter dependence"),
    h("p.hint", null, "Share of unsafe solutions by parameter value; strongest dependence first (Cramér's V). Dashed: the share of all solutions. Hollow: few solutions. A search does not sample evenly, and its solutions descend from each other: this shows where unsafe solutions were found, neither how likely they are nor what made them unsafe."),
    panels, all);
  let few = FEW;
  let read = null;

  const load = loadOnNews(async () => {
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
      if (all >= LEAST) top = Math.max(top, one.unsafe[place] / all);
    });
  }
  return Math.min(1, Math.max(0.1, Math.ceil(top * 10) / 10));
}

function panel(one, overall, top) {
  const groups = one.places.map((at, place) => ({ at, all: one.counts[place], hits: one.unsafe[place], label: one.labels[place] })).filter((group) => group.all > 0);
  const scale = one.low !== null && !one.labels.length;
  const [low, high] = scale ? [one.low, one.high] : [-0.5, one.places.length - 0.5];
  const first = one.labels.length && !scale ? one.places[0] : 0;
  const along = one.log ? Math.log : Number;
  const x = (at) => LEFT + ((along(at) - (scale ? 0 : first) - along(low)) / (along(high) - along(low) || 1)) * (WIDTH - 2 * LEFT);
  const y = (share) => HEIGHT - 4 - (Math.min(share, top) / top) * (HEIGHT - 12);
  const colour = "var(--unsafe)";
  const name = one.title || spaced(one.parameter).replace(".", ": ");
  const words = groups.map((group) => `${group.label ?? figure(group.at)}: ${percent(group.hits / group.all)} of ${group.all}`).join("; ");
  const picture = h("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img", "aria-label": `${name}. Unsafe: ${words || "no solution has a value"}.` },
    h("line", { x1: 0, x2: WIDTH, y1: y(overall), y2: y(overall), stroke: "var(--muted)", "stroke-width": 1, "stroke-dasharray": "3 3" }),
    !one.labels.length && h("polyline", { points: groups.map((group) => `${x(group.at)},${y(group.hits / group.all)}`).join(" "), fill: "none", stroke: colour, "stroke-width": 1.4 }),
    groups.map((group) => h("circle", { cx: x(group.at), cy: y(group.hits / group.all), r: 3.6, stroke: colour, fill: group.all < LEAST ? "var(--card)" : colour })));
  const ends = one.labels.length ? [groups[0]?.label, groups.length > 1 && groups.at(-1)?.label] : [figure(low), `${figure(high)} ${one.unit}`];
  return h("figure.panel", null,
    h("figcaption", null, h("strong", null, name), h("div.small.muted", null, `V ${figure(one.strength, 2)}, ${plural(groups.reduce((sum, group) => sum + group.all, 0), "solution")}`)),
    h("div.plot", null, h("div.shares.small.muted", { "aria-hidden": "true" }, [top, top / 2, 0].map((share) => h("span", null, percent(share)))), picture, h("span"),
      one.labels.length && groups.length <= 6
        ? h("div.groups.small.muted", { "aria-hidden": "true" }, groups.map((group) => h("span", { title: group.label }, spaced(group.label))))
        : h("div.ends.small.muted", { "aria-hidden": "true" }, ends.map((words) => h("span", null, words || "")))));
}

/**
 * Return the card of repeats with other seeds; ``news(sequence)`` loads them.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 */
export function repeatsCard(context, id) {
  const node = h("section.card", { hidden: true, "aria-label": "Repeats" });
  let told = "";
  let later = null;

  const load = loadOnNews(async () => {
    const again = await context.get(`campaigns/${id}/repeats`);
    showRepeats(again);
    clearTimeout(later);
    // Repeats are separate campaigns: progress of this one does not announce their news.
    if (again.some((one) => one.status === "running")) later = setTimeout(() => load(`${told} ${performance.now()}`), 5_000);
  }, { signal: context.signal, refuse: context.complain, leastMs: 10_000, share: 0.05 });

  function showRepeats(read) {
    node.hidden = read.length === 0;
    replace(node, h("h2", null, "Repeats with other seeds"), read.map((one) => h("div.repeat", null,
      h("p", null, h("a", { href: link("campaigns", one.campaign) }, which(one)), " ", badge(one.status)), h("p", null, one.words))));
  }

  function which(one) {
    const boundary = one.selection === "boundary", best = boundary && one.solutions.length < one.distinct;
    const what = best ? `the best ${count(one.solutions.length)} of ${plural(one.distinct, "boundary solution")}` : boundary ? plural(one.solutions.length, "boundary solution") : one.solutions.length === 1 ? `solution ${one.solutions[0].number}` : plural(one.solutions.length, "selected solution");
    return `${what}, ${one.solutions.length === 1 ? "" : "each "}${count(one.repeats)} times`;
  }

  context.signal.addEventListener("abort", () => clearTimeout(later), { once: true });
  node.news = (sequence) => {
    if (sequence === told) return;
    told = sequence;
    load(sequence);
  };
  return node;
}

const MOST_LETTERS = 120;

/** Return the card of a campaign's settings, with descriptions from the catalogue. */
export function settingsCard(body, catalogue) {
  const problem = catalogue.problems.find((one) => one.id === body.problem.id);
  const algorithm = catalogue.algorithms.find((one) => one.id === body.algorithm.id);
  return h("section.card.settings", { "aria-label": "Settings" }, h("h2", null, "Settings"),
    h("div.grid-2", null,
      part(`Problem ${body.problem.id}`, problem, body.problem.params),
      part(`Algorithm ${body.algorithm.id}`, algorithm, body.algorithm.params)),
    part("Campaign", null, {
      simulations: body.budget.simulations, seed: body.seed, priority: body.priority, repeats: body.repeats, ...body.execution,
      ...(body.llm ? { language_model: body.llm } : {}),
    }));
}

function part(title, plugin, params) {
  return h("div", null, h("h3", null, title), plugin && h("p.small.muted", null, plugin.summary),
    h("table", null, h("caption.read-out", null, title), h("tbody", null, Object.entries(params).map(([name, value]) => {
      const described = plugin?.params?.properties?.[name];
      const written = typeof value === "string" ? value : JSON.stringify(value);
      return h("tr", null, h("th", { scope: "row", title: described?.description ?? null }, spaced(name)),
        h("td.mono", null, written.length > MOST_LETTERS ? `${written.slice(0, MOST_LETTERS)}…` : written, described?.unit ? ` ${described.unit}` : ""));
    }))));
}

/** Return the card of what only matters to those who look closely: how the search went on, and the digest; ``update`` takes the progress. */
export function aboutCard(algorithm) {
  const words = h("p.small");
  const card = h("section.card", { "aria-label": "About the run" }, h("details", null, h("summary", null, h("h2", null, "About the run")), words));
  card.update = (progress, generations) => text(words, inWords(progress, generations, algorithm));
  return card;
}

/** Describe the state of the search in sentences. */
function inWords(progress, generations, algorithm) {
  const told = [];
  const last = generations.list.at(-1);
  told.push(`${algorithm?.summary ?? "The search"} ${plural(progress.generation, "generation")} completed.`.replace(/\.\. /, ". "));
  if (progress.status === "running" && progress.asking) told.push(`Language model: ${progress.asking}.`);
  else if (progress.status === "running") {
    told.push(`Generation ${progress.generation + 1} is being simulated: ${plural(progress.leased, "job")} on workers, ${count(progress.queued)} in the queue.`);
  } else if (progress.status === "paused") told.push("Paused: workers get no jobs.");
  if (progress.minimises && last?.best_fitness !== null && last?.best_fitness !== undefined) {
    told.push(`${capital(progress.minimises)} of the last generation: best ${figure(last.best_fitness)}, median ${figure(last.median_fitness)}.`);
  }
  const origins = Object.entries(progress.origins);
  if (origins.length) told.push(`Origins of solutions: ${origins.map(([name, number]) => `${spaced(name)} ${count(number)}`).join(", ")}.`);
  if (progress.digest) told.push(`SHA-256 of the archive: ${progress.digest}.`);
  if (last) told.push(`The last step of the algorithm took ${figure(last.step_s, 2)} s.`);
  return told.join(" ");
}
