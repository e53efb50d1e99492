/** The cards of a solution other than its replay: verdicts, parameters, neighbourhood, repeats with other seeds. */

import { isOpen } from "../../api.js";
import { h, replace, text } from "../../dom.js";
import { capital, count, figure, percent, plainId, plural, sentence, spaced, value } from "../../format.js";
import { link } from "../../router.js";
import { badge, outcomeBadge } from "../../parts/elements.js";
import { seconds } from "./episode.js";

const USUAL_REPEATS = 20;
const MOST_REPEATS = 10_000;
const NO_GENERATION = 1_000_000_000;

/** Return the requirement whose robustness is the solution's, of those that decide; null if unknown. */
export function judgedBy(solution) {
  const deciding = solution.requirements.filter((name) => name in (solution.verdicts ?? {}));
  return deciding.find((name) => solution.verdicts[name].robustness === solution.robustness) ?? deciding[0] ?? null;
}

/** Return a robustness with its unit: ``−0.5 m``. */
export function withUnit(robustness, unit) {
  return `${figure(robustness)}${unit ? ` ${unit}` : ""}`;
}

/**
 * Return the card of a solution's verdicts; null if it has none.
 *
 * @param {object} solution
 * @param {string|null} judged The requirement that is shown first.
 * @param {(time_s: number) => void} goTo Jumps to a time of the episode.
 */
export function verdicts(solution, judged, goTo) {
  const found = Object.entries(solution.verdicts ?? {});
  if (found.length === 0) return null;
  found.sort(([a], [b]) => (b === judged) - (a === judged));
  return h("section.card", { "aria-label": "Verdicts" }, h("h2", null, "Verdicts"), h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of verdicts" }, h("table.verdicts", null,
    h("caption", null, "Robustness is the distance to violation; below zero the requirement is violated."),
    h("thead", null, h("tr", null, ["Requirement", "Verdict"].map((name) => h("th", { scope: "col" }, name)),
      h("th.right", { scope: "col" }, "Robustness"))),
    h("tbody", null, found.map(([name, verdict]) => {
      const at = verdict.violated_at_s;
      const violated = verdict.robustness < 0;
      return h("tr", { class: solution.requirements.includes(name) ? "chosen" : null },
        h("th", { scope: "row" }, spaced(plainId(name)), solution.requirements.includes(name) && h("span.small.muted", null, ", decisive")),
        h("td", null, badge(violated ? (solution.requirements.includes(name) ? "unsafe" : "other") : "safe", violated ? "violated" : "holds"),
          at !== null && [" ", h("button.quiet.figure", { type: "button", onclick: () => goTo(at) }, `at ${seconds(at)}`)],
          h("div.small.muted", null, solution.spec?.formulas?.[name]?.stl),
          h("div.small.muted", null, solution.violated.find((one) => one.requirement === name)?.avoidable_words)),
        h("td.right", null, withUnit(verdict.robustness, verdict.unit)));
    })))));
}

/** Return the cards of a solution's parameters, one per component; names with a common prefix become columns. If known, values are those that the drive had, and the others are left out. */
export function parameters({ parameters: given, activity, titles }) {
  const inactive = new Set(activity?.inactive);
  return Object.entries(activity?.effective ?? given).map(([component, values]) => {
    const shown = Object.fromEntries(Object.entries(values).map(([name, one]) => [name, inactive.has(`${component}.${name}`) ? null : one]));
    const partial = Object.values(shown).includes(null);
    const idle = activity?.idle.includes(component);
    return h("section.card", { "aria-label": `Parameters: ${spaced(component)}` },
      h("h2", null, capital(spaced(component))),
      idle ? h("p", null, `The ${component === "behaviour" ? "injected behaviour" : spaced(component)} had no part in this drive.`)
        : h("div.scroll.tall", { tabindex: 0, role: "region", "aria-label": `Table of ${spaced(component)}` },
          grouped(shown).map((group) => (group.prefixes ? crossTable(group, component, titles) : plainTable(group, component, titles)))),
      !idle && partial && h("p.hint", null, "–: inactive in this drive."),
      !idle && !same(values, given[component], inactive, component) && h("p.hint", null, "The drive ended before a time window did; the table shows the window up to there."));
  });
}

function same(values, given, inactive, component) {
  return Object.entries(values).every(([name, one]) => one === given[name] || inactive.has(`${component}.${name}`));
}

function plainTable({ entries }, component, titles) {
  return h("table", null, h("caption.read-out", null, `Parameters of ${spaced(component)}`),
    h("tbody", null, entries.map(([name, one]) => h("tr", null, h("th", { scope: "row" }, titles[`${component}.${name}`] ?? spaced(name)), h("td", null, value(one))))));
}

/** Return a table of groups that have the same parameters; its longer side goes down. */
function crossTable({ prefixes, names, at }, component, titles) {
  const parts = (prefix, name) => titles[`${component}.${prefix}.${name}`]?.split(": ") ?? [readable(prefix), readable(name)];
  const told = new Map([...prefixes.map((prefix) => [prefix, parts(prefix, names[0])[0]]), ...names.map((name) => [name, parts(prefixes[0], name)[1]])]);
  const groupsDown = prefixes.length > names.length;
  const [rows, columns] = groupsDown ? [prefixes, names] : [names, prefixes];
  return h("table", null, h("caption.read-out", null, `${prefixes.length} groups of parameters`),
    h("thead", null, h("tr", null, h("td"), columns.map((name) => h("th", { scope: "col" }, told.get(name))))),
    h("tbody", null, rows.map((row) => h("tr", null, h("th", { scope: "row" }, told.get(row)),
      columns.map((column) => h("td", null, value(groupsDown ? at(row, column) : at(column, row))))))));
}

function readable(name) {
  return spaced(name).replaceAll(".", " ");
}

/** Return parameters in groups: first those without a dot, then the others by the part of their name before the last dot. */
function grouped(values) {
  const found = new Map();
  const loose = [];
  for (const [name, one] of Object.entries(values)) {
    const dot = name.lastIndexOf(".");
    if (dot < 0) loose.push([name, one]);
    else getOr(found, name.slice(0, dot), () => new Map()).set(name.slice(dot + 1), one);
  }
  const alike = new Map();
  for (const [prefix, members] of found) {
    const names = [...members.keys()];
    getOr(alike, names.join("\n"), () => ({ prefixes: [], names, at: (group, name) => found.get(group).get(name) })).prefixes.push(prefix);
  }
  return [...(loose.length ? [{ entries: loose }] : []), ...alike.values()];
}

function getOr(mapping, key, make) {
  if (!mapping.has(key)) mapping.set(key, make());
  return mapping.get(key);
}

/**
 * Return the cards of a solution's neighbourhood: ``opposite``, the nearest solution with the other verdict, ``card``, and
 * ``table``, its nearest solutions; ``update`` takes the response of the API.
 */
export function neighbourhood(campaign) {
  const opposite = h("section.card.opposite", { "aria-label": "Nearest opposite", hidden: true });
  const words = h("p", { id: "neighbourhood-words" });
  const bar = intervalBar(campaign.finds.includes("boundary"));
  const card = h("section.card", { "aria-label": "Neighbourhood" }, h("h2", null, "Neighbourhood"), words, bar);
  const caption = h("caption");
  const rows = h("tbody");
  const table = h("section.card", { "aria-label": "Nearest solutions" }, h("h2", null, "Nearest solutions"),
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of the nearest solutions" }, h("table", null, caption,
      h("thead", null, h("tr", null, h("th", { scope: "col" }, "Solution"), h("th", { scope: "col" }, "Verdict"),
        ["Distance", "Robustness", campaign.finds.includes("boundary") && "Fitness"].filter(Boolean).map((name) => h("th.right", { scope: "col" }, name)))),
      rows)));

  function showOpposite({ opposite: other }) {
    opposite.hidden = other === null;
    const told = JSON.stringify(other);
    if (other === null || opposite.dataset.told === told) return;
    opposite.dataset.told = told;
    const place = link("campaigns", campaign.id, "solutions", other.number);
    replace(opposite, h("h2", null, `Nearest ${other.unsafe ? "unsafe" : "safe"} solution`),
      h("p", null, h("a", { href: place }, `Solution ${other.number}`), ` is ${figure(other.distance)} away: `, outcomeBadge(other)),
      h("p.lead", null, `What differs ${other.unsafe ? "there" : "here"}: ${sentence(other.change)}`),
      h("p.hint", null, [
        `${plural(other.differences, "parameter")} ${other.differences === 1 ? "differs" : "differ"}.`,
        other.same_seed ? "Both had the same episode seed, so chance plays no role." : "They had different episode seeds, so chance may play a role.",
      ].join(" ")));
  }

  function update(read) {
    showOpposite(read);
    text(words, neighbourhoodWords(read));
    bar.update({ low: read.interval[0], high: read.interval[1], part: read.unsafe_neighbours / read.neighbours, p_th: read.p_th });
    text(caption, `The ${plural(read.nearest.length, "nearest", "nearest")} of ${count(read.evaluated)} evaluated solutions; those within a distance of ${figure(read.radius)} are neighbours.`);
    replace(rows, read.nearest.map((one) => h("tr", null,
      h("th", { scope: "row" }, h("a.row", { href: link("campaigns", campaign.id, "solutions", one.number) }, String(one.number))),
      h("td", null, outcomeBadge(one)),
      h("td.right", null, figure(one.distance), h("span.read-out", null, one.within ? ", a neighbour" : ""), !one.within && h("span.small.muted", null, " beyond")),
      h("td.right", null, figure(one.robustness)), campaign.finds.includes("boundary") && h("td.right", null, figure(one.fitness)))));
  }
  return { opposite, card, table, update };
}

/** Return a bar from 0 to 1 with an unsafe share, its interval and, in a search for the boundary, p_th; ``update`` takes other values. */
function intervalBar(aboutBoundary) {
  const range = h("i.range");
  const share = h("i.share");
  const edge = h("i.p-th");
  const bar = h("div.interval", { role: "img" }, range, aboutBoundary && edge, share);
  const node = h("div.interval-box", null, bar,
    h("div.interval-scale.small.muted", { "aria-hidden": "true" }, [0, 0.25, 0.5, 0.75, 1].map((at) => h("span", null, percent(at)))),
    h("ul.legend", null, h("li", null, h("i.key.share"), "unsafe share"), h("li", null, h("i.key.range"), "its interval"),
      aboutBoundary && h("li", null, h("i.key.p-th"), "boundary (p_th)")));
  node.update = ({ low, high, part, p_th }) => {
    range.style.left = `${100 * low}%`;
    range.style.width = `${100 * (high - low)}%`;
    share.style.left = `${100 * part}%`;
    edge.style.left = `${100 * p_th}%`;
    bar.setAttribute("aria-label", `${percent(part)} unsafe, interval ${percent(low)} to ${percent(high)}${aboutBoundary ? `; the boundary is at ${percent(p_th)}` : ""}`);
  };
  return node;
}

function neighbourhoodWords({ neighbours, unsafe_neighbours, radius, interval: [low, high], p_th, confidence, rated }) {
  const level = `${Number((100 * confidence).toFixed(1))}%`;
  const counts = `${count(unsafe_neighbours)} of ${plural(neighbours, "solution")} within a distance of ${figure(radius)} ${unsafe_neighbours === 1 ? "is" : "are"} unsafe`;
  const share = `${counts}: ${percent(unsafe_neighbours / neighbours)}, ${level} interval ${percent(low)} to ${percent(high)}.`;
  return `${share} ${rated ? boundaryWords(low, high, p_th) : "This search does not look for a boundary."}`;
}

function boundaryWords(low, high, p_th) {
  const side = low > p_th ? "below" : high < p_th ? "above" : "within";
  return `The boundary at ${percent(p_th)} lies ${side} this interval.`;
}

/** Return the card that simulates a solution again with other seeds, and shows the results. */
export function repeats(context, campaign, number) {
  const words = h("div", { "aria-live": "polite" });
  const rows = h("tbody");
  const table = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of repeats", hidden: true }, h("table", null,
    h("caption", null, "Each row is a campaign that simulates this solution with other seeds."),
    h("thead", null, h("tr", null, ["Campaign", "Status", "Simulated", "Unsafe", "Share", "Interval"].map((name, index) => h(index > 1 ? "th.right" : "th", { scope: "col" }, name)))),
    rows));
  const wanted = h("input", { id: "repeats", type: "number", min: 2, max: MOST_REPEATS, step: 1, value: USUAL_REPEATS, required: true });
  const go = h("button.primary", { type: "submit" }, "Simulate");
  const form = h("form.inline", { onsubmit: submit }, h("label", { for: "repeats" }, "Simulate again"), wanted, h("span", null, "times with other seeds"), go);
  const place = h("div");
  const card = h("section.card", { "aria-label": "Repeats with other seeds" }, h("h2", null, "Repeats with other seeds"),
    h("p", null, "This solution was simulated once. Simulating it again, with other pedestrians and other noise, shows how likely it is to be unsafe."),
    place, words, table);

  async function submit(event) {
    event.preventDefault();
    go.disabled = true;
    const answer = await context.act("POST", `campaigns/${campaign.id}/repeats`, null, { json: { numbers: [number], repeats: Number(wanted.value) } });
    go.disabled = false;
    if (answer) polling.now();
  }

  function update(read) {
    const found = read.map((one) => ({ ...one, result: one.solutions.find((solution) => solution.number === number) })).filter((one) => one.result).reverse();
    table.hidden = found.length === 0;
    replace(rows, found.map(({ result, ...one }) => h("tr", null,
      h("td", null, h("a", { href: link("campaigns", one.campaign) }, one.selection === "boundary" ? (one.solutions.length < one.distinct ? `best ${count(one.solutions.length)} of the boundary` : "whole boundary") : one.solutions.length > 1 ? `this and ${plural(one.solutions.length - 1, "other")}` : "this solution")),
      h("td", null, badge(one.status)),
      h("td.right", null, `${count(result.evaluated)} of ${count(one.repeats)}`), h("td.right", null, count(result.unsafe)),
      h("td.right", null, result.evaluated ? percent(result.probability) : "–"),
      h("td.right", null, result.evaluated ? `${percent(result.low)} to ${percent(result.high)}` : "–"))));
    text(words, found.length ? repeatsWords(found[0]) : "");
  }

  function offer(status) {
    if (!context.may.steer || place.firstChild === form) return;
    replace(place, isOpen(status) ? h("p.hint", null, `You can simulate it again when its campaign has ended; the campaign is ${status}.`) : form);
  }

  offer(campaign.status);
  if (context.may.steer && isOpen(campaign.status)) {
    const ended = new AbortController();
    context.watch(`campaigns/${campaign.id}/progress?since=${NO_GENERATION}`, (read) => {
      offer(read.status);
      if (!isOpen(read.status)) ended.abort();
    }, { refuse: () => {}, until: ended.signal });
  }
  const polling = context.watch(`campaigns/${campaign.id}/repeats`, update, {
    busy: (read) => read.some((one) => one.status === "running"), refuse: () => {},
  });
  return card;
}

function repeatsWords({ result, repeats: wanted, p_th, status }) {
  if (!result.evaluated) return status === "running" ? "Workers are simulating it." : "There are no results yet.";
  const soFar = result.evaluated < wanted ? " so far" : "";
  const counts = `${count(result.unsafe)} of ${plural(result.evaluated, "simulation")} with other seeds ${result.unsafe === 1 ? "was" : "were"} unsafe${soFar}`;
  const share = `${percent(result.probability)}, interval ${percent(result.low)} to ${percent(result.high)}`;
  return `${counts}: ${share}. ${CONCLUSIONS[result.conclusion](percent(p_th), result.evaluated)}`;
}

const CONCLUSIONS = {
  below: (p_th) => `The interval lies below p_th, ${p_th}.`,
  above: (p_th) => `The interval lies above p_th, ${p_th}.`,
  near: (p_th) => `This solution itself is near p_th, ${p_th}.`,
  inconclusive: (p_th, times) => `Inconclusive with ${plural(times, "simulation")}: the interval contains p_th, ${p_th}, and much else.`,
};
