/** The pairs across the boundary that the methods of an experiment found, and how many of them hold. */

import { h, keyed, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { link } from "../../router.js";
import { callout } from "../../parts/elements.js";
import { loadWhenFinished, plainRow, sentence, tableOf, tested } from "./tables.js";

/** Return the section of pairs; ``want(finished)`` shows it, and says how many campaigns have finished. It follows the follow-ups that end. */
export function pairsSection(path, context) {
  const computing = h("p.scoring", { role: "status" });
  const body = h("div.stack", { hidden: true });
  const node = h("section.card.stack", { "aria-label": "Pairs across the boundary", hidden: true }, h("h2", null, "Pairs across the boundary"), computing, body);
  const problems = h("div.stack");
  const about = h("p.hint");
  const leftOut = h("ul.reasons");
  const left = callout("warn", "Left out everywhere here, as they have too many pairs:", leftOut);
  const repeats = repeatsTable();
  body.append(left, problems, about, h("details", null, h("summary", null, "Campaigns"), repeats));

  const loading = loadWhenFinished(`${path}/pairs`, context, computing, (read) => {
    body.hidden = read.counted === 0 && read.left_out.length === 0;
    left.hidden = read.left_out.length === 0;
    keyed(leftOut, read.left_out, (one) => one.campaign, leftOutItem);
    keyed(problems, read.problems.map((one) => problemOf(one, read)), (one) => one.problem, problemPart);
    text(about, `The sides of a pair are at most ${figure(read.eps)} apart, or differ in one step of one parameter; pairs are at least ${figure(read.d_th)} apart. `
      + `Confirmed: with other seeds, the safe side is unsafe with a probability of at most ${percent(read.rule.safe_at_most)}, and the unsafe side with one of at least ${percent(read.rule.unsafe_at_least)}, with an error rate of ${percent(read.rule.error)}. `
      + "Precision: the share of the checked pairs that were confirmed. Component: the share of the unsafe sides that are safe with ground truth in place of the component.");
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

  /** Load the pairs again when follow-ups end: those that have ended count. They may be asked for at any time. */
  function follow() {
    const take = (read) => {
      followed = `${read.finished} ${read.campaigns}`;
      want();
    };
    context.watch(`${path}/follow-ups`, take, { refuse: () => take({ finished: 0, campaigns: 0 }) });
  }
  return node;
}

function leftOutItem({ campaign, method, problem, seed, reason }) {
  return h("li", null, h("a", { href: link("campaigns", campaign, "pairs") }, campaign), ` (${method} on ${problem}, seed ${seed}): ${reason}`);
}

function problemOf({ problem, says }, read) {
  const ours = (list) => list.filter((one) => one.problem === problem);
  return { problem, says, alone: read.problems.length === 1, standings: ours(read.standings), duels: ours(read.duels) };
}

function problemPart(first) {
  const measure = h("p");
  const words = h("ul.sentences");
  const standings = standingsTable(first.problem);
  const heading = h("h3", null, first.problem);
  const node = h("div.stack", null, heading, measure, words, standings);
  node.update = (one) => {
    heading.hidden = one.alone;
    text(measure, one.says);
    keyed(words, one.duels.map(conclusion), ([key]) => key, sentence);
    standings.update(one.standings);
  };
  node.update(first);
  return node;
}

function conclusion(one) {
  return [`${one.first}:${one.second}`, `${one.first} and ${one.second}`,
    `: ${one.measure} pairs ${one.first_mean.toFixed(1)} against ${one.second_mean.toFixed(1)}${tested(one)}; `, `${one.says}.`];
}

function standingsTable(problem) {
  const node = tableOf(`Pairs of each method on ${problem}`, [["Method"], ["Confirmed per campaign", 1], ["Distinct per campaign", 1], ["Precision", 1], ["Component", 1]]);
  const say = (one) => [one.method, mean(one.confirmed), mean(one.distinct), proportion(one.precision), proportion(one.component)];
  node.update = (rows) => keyed(node.body, rows, (row) => row.method, plainRow(say, [1, 1, 1, 1]));
  return node;
}

function repeatsTable() {
  const node = tableOf("Pairs of each finished campaign", [["Campaign"], ["Method"], ["Problem"], ["Seed", 1], ["Distinct", 1], ["Checked", 1], ["Confirmed", 1]]);
  node.update = (repeats) => keyed(node.body, repeats, (one) => one.campaign, (first) => {
    const cells = [0, 0, 1, 1, 1, 1].map((right) => h(right ? "td.right" : "td"));
    const row = h("tr", null, h("th", { scope: "row" }, h("a", { href: link("campaigns", first.campaign, "pairs") }, first.campaign)), cells);
    row.update = (one) => {
      const values = [one.method, one.problem, one.seed, count(one.distinct), count(one.checked), one.confirmed === null ? "–" : `${count(one.confirmed)} of ${plural(one.judged, "pair")}`];
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
