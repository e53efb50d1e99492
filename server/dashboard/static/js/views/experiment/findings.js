/** What the methods of an experiment found, thresholds or pairs, and how many of it hold. */

import { h, keyed, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { link } from "../../router.js";
import { callout } from "../../parts/elements.js";
import { loadWhenFinished, plainRow, sentence, tableOf, tested } from "./tables.js";

const COMPONENT = ["Component", (one) => proportion(one.component)];

/** Kinds of findings that experiments compare: headings, the page of a campaign that has them, columns, and what counts. */
export const THRESHOLDS = {
  name: "thresholds",
  place: [],
  title: "Thresholds",
  columns: [
    ["Confirmed per campaign", (one) => mean(one.confirmed)],
    ["Kinds of these", (one) => mean(one.confirmed_kinds)],
    ["Distinct per campaign", (one) => mean(one.distinct)],
    ["Kinds", (one) => mean(one.kinds)],
    ["Held at both ends", (one) => proportion(one.held)],
    COMPONENT,
  ],
  campaigns: [
    ["Found", (one) => count(one.found)],
    ["Distinct", (one) => count(one.distinct)],
    ["Kinds", (one) => count(one.kinds)],
    ["Confirmed", (one) => (one.confirmed === null || one.computed ? "–" : `${count(one.confirmed)} of ${plural(one.judged, "threshold")}`)],
  ],
  about: (read) => `Thresholds of one kind that are less than ${figure(read.d_th)} apart count once. `
    + "A search that never varies one number alone finds none. Held: among the thresholds whose ends were simulated with other seeds, those with at most 20% and at least 80% unsafe drives. "
    + `${confirmed(read, "end")} Component: the share of the unsafe ends that are safe with ground truth in place of the component.`,
};
export const PAIRS = {
  name: "pairs",
  place: ["pairs"],
  title: "Pairs across the boundary",
  columns: [
    ["Confirmed per campaign", (one) => mean(one.confirmed)],
    ["Distinct per campaign", (one) => mean(one.distinct)],
    ["Precision", (one) => proportion(one.precision)],
    COMPONENT,
  ],
  campaigns: [
    ["Distinct", (one) => count(one.distinct)],
    ["Checked", (one) => count(one.checked)],
    ["Confirmed", (one) => (one.confirmed === null ? "–" : `${count(one.confirmed)} of ${plural(one.judged, "pair")}`)],
  ],
  about: (read) => `The sides of a pair are at most ${figure(read.eps)} apart, or differ in one step of one parameter; pairs are at least ${figure(read.d_th)} apart. `
    + `${confirmed(read, "side")} `
    + "Precision: the share of the checked pairs that were confirmed. Component: the share of the unsafe sides that are safe with ground truth in place of the component.",
};

function confirmed({ rule }, side) {
  return `Confirmed: with other seeds, the safe ${side} is unsafe with a probability of at most ${percent(rule.safe_at_most)}, and the unsafe ${side} with one of at least ${percent(rule.unsafe_at_least)}, with an error rate of ${percent(rule.error)}.`;
}

/** Return the section of a kind; ``want(finished)`` shows it, and says how many campaigns have finished. It follows the follow-ups that end. */
export function findingsSection(kind, path, context) {
  const computing = h("p.scoring", { role: "status" });
  const body = h("div.stack", { hidden: true });
  const node = h("section.card.stack", { "aria-label": kind.title, hidden: true }, h("h2", null, kind.title), computing, body);
  const problems = h("div.stack");
  const about = h("p.hint");
  const leftOut = h("ul.reasons");
  const left = callout("warn", `Left out everywhere here, as they have too many ${kind.name}:`, leftOut);
  const repeats = repeatsTable(kind);
  body.append(left, problems, about, h("details", null, h("summary", null, "Campaigns"), repeats));

  const loading = loadWhenFinished(`${path}/${kind.name}`, context, computing, (read) => {
    const omitted = read.left_out ?? [];
    body.hidden = read.counted === 0 && omitted.length === 0;
    left.hidden = omitted.length === 0;
    keyed(leftOut, omitted, (one) => one.campaign, (one) => leftOutItem(kind, one));
    keyed(problems, read.problems.map((one) => problemOf(one, read)), (one) => one.problem, (one) => problemPart(kind, one));
    text(about, kind.about(read));
    repeats.update(read.repeats);
  });
  let finished = 0; // campaigns
  let followed = null; // what there was of follow-ups
  const want = () => { if (finished > 0 && followed !== null) loading.want(`${finished} ${followed}`); };
  node.want = (now) => {
    finished = now;
    if (node.hidden) {
      node.hidden = false;
      follow();
    }
    want();
  };

  /** Load the findings again when follow-ups end: those that have ended count. They may be asked for at any time. */
  function follow() {
    const take = (read) => {
      followed = `${read.finished} ${read.campaigns}`;
      want();
    };
    context.watch(`${path}/follow-ups`, take, { refuse: () => take({ finished: 0, campaigns: 0 }) });
  }
  return node;
}

function leftOutItem(kind, { campaign, method, problem, seed, reason }) {
  return h("li", null, h("a", { href: link("campaigns", campaign, ...kind.place) }, campaign), ` (${method} on ${problem}, seed ${seed}): ${reason}`);
}

function problemOf({ problem, says }, read) {
  const ours = (list) => list.filter((one) => one.problem === problem);
  return { problem, says, alone: read.problems.length === 1, standings: ours(read.standings), duels: ours(read.duels) };
}

function problemPart(kind, first) {
  const measure = h("p");
  const words = h("ul.sentences");
  const standings = standingsTable(kind, first.problem);
  const heading = h("h3", null, first.problem);
  const node = h("div.stack", null, heading, measure, words, standings);
  node.update = (one) => {
    heading.hidden = one.alone;
    text(measure, one.says);
    keyed(words, one.duels.map((duel) => conclusion(kind, duel)), ([key]) => key, sentence);
    standings.update(one.standings);
  };
  node.update(first);
  return node;
}

function conclusion(kind, one) {
  return [`${one.first}:${one.second}`, `${one.first} and ${one.second}`,
    `: ${one.measure} ${kind.name} ${one.first_mean.toFixed(1)} against ${one.second_mean.toFixed(1)}${tested(one)}; `, `${one.says}.`];
}

function standingsTable(kind, problem) {
  const node = tableOf(`${kind.title} of each method on ${problem}`, [["Method"], ...kind.columns.map(([name]) => [name, 1])]);
  const say = (one) => [one.method, ...kind.columns.map(([, value]) => value(one))];
  node.update = (rows) => keyed(node.body, rows, (row) => row.method, plainRow(say, kind.columns.map(() => 1)));
  return node;
}

function repeatsTable(kind) {
  const node = tableOf(`${kind.title} of each finished campaign`, [["Campaign"], ["Method"], ["Problem"], ["Seed", 1], ...kind.campaigns.map(([name]) => [name, 1])]);
  node.update = (repeats) => keyed(node.body, repeats, (one) => one.campaign, (first) => {
    const cells = [0, 0, 1, ...kind.campaigns.map(() => 1)].map((right) => h(right ? "td.right" : "td"));
    const row = h("tr", null, h("th", { scope: "row" }, h("a", { href: link("campaigns", first.campaign, ...kind.place) }, first.campaign)), cells);
    row.update = (one) => {
      const values = [one.method, one.problem, one.seed, ...kind.campaigns.map(([, value]) => value(one))];
      cells.forEach((cell, index) => text(cell, values[index]));
    };
    row.update(first);
    return row;
  });
  return node;
}

function mean(value) {
  if (value === null) return "–";
  return value.low === null ? value.mean.toFixed(1) : `${value.mean.toFixed(1)} (${Math.max(0, value.low).toFixed(1)} to ${value.high.toFixed(1)})`;
}

function proportion(value) {
  return value === null ? "–" : `${percent(value.share)} (${count(value.count)} of ${count(value.of)})`;
}
