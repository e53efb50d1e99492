/** The pairs across the boundary that the methods of an experiment found, and how many of them hold. */

import { h, keyed, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { link } from "../../router.js";
import { loadWhenFinished, plainRow, pValue, sentence, tableOf } from "./tables.js";

const AGAIN_S = 10;

/** Return the section of pairs; ``want(finished, choice)`` loads it when more campaigns have finished, and says what the experiment asks for. */
export function pairsSection(path, context) {
  const computing = h("p.scoring", { role: "status" });
  const body = h("div.stack", { hidden: true });
  const node = h("section.card.stack", { "aria-label": "Pairs across the boundary", hidden: true }, h("h2", null, "Pairs across the boundary"), computing, body);
  const problems = h("div.stack");
  const about = h("p.hint");
  const repeats = repeatsTable();
  body.append(problems, about, h("details", null, h("summary", null, "Campaigns"), repeats));

  const loading = loadWhenFinished(`${path}/pairs`, context, computing, (read) => {
    body.hidden = read.counted === 0;
    keyed(problems, read.problems.map((one) => problemOf(one, read)), (one) => one.problem, problemPart);
    text(about, `The sides of a pair are at most ${figure(read.eps)} apart, or differ in one step of one parameter; pairs are at least ${figure(read.d_th)} apart. `
      + "Confirmed: with at least ten other seeds a side, the safe side was unsafe in at most 20%, and the unsafe side in at least 80%. "
      + "Precision: the share of the checked pairs that were confirmed. Component: the share of the unsafe sides that are safe with ground truth in place of the component.");
    repeats.update(read.repeats);
    return confirms && unfinished(read) ? AGAIN_S : 0;
  });
  let confirms = false;
  node.want = (finished, choice) => {
    node.hidden = false;
    confirms = choice.confirm > 0;
    loading.want(finished);
  };
  return node;
}

/** Return whether pairs are still being simulated again, as far as the response tells. */
function unfinished(read) {
  return read.repeats.some((one) => !one.computed && one.decided < one.distinct);
}

function problemOf({ problem, says }, read) {
  const ours = (list) => list.filter((one) => one.problem === problem);
  return { problem, says, alone: read.problems.length === 1, standings: ours(read.standings), duels: ours(read.duels) };
}

function problemPart(first) {
  const measure = h("p");
  const words = h("ul.sentences");
  const standings = standingsTable(first.problem);
  const node = h("div.stack", null, !first.alone && h("h3", null, first.problem), measure, words, standings);
  node.update = (one) => {
    text(measure, one.says);
    keyed(words, one.duels.map(conclusion), ([key]) => key, sentence);
    standings.update(one.standings);
  };
  node.update(first);
  return node;
}

function conclusion(one) {
  return [`${one.first}:${one.second}`, `${one.first} and ${one.second}`,
    `: ${one.measure} pairs ${one.first_mean.toFixed(1)} against ${one.second_mean.toFixed(1)}, U ${figure(one.u)}, A12 ${one.a12.toFixed(2)} (${one.effect}), p ${pValue(one.p)}, corrected ${pValue(one.p_holm)}; `, `${one.says}.`];
}

function standingsTable(problem) {
  const node = tableOf(`Pairs of each method on ${problem}`, [["Method"], ["Confirmed in a campaign", 1], ["Distinct in a campaign", 1], ["Precision", 1], ["Component", 1]]);
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
      const told = [one.method, one.problem, one.seed, count(one.distinct), count(one.checked), one.confirmed === null ? "–" : `${count(one.confirmed)} of ${plural(one.decided, "pair")}`];
      cells.forEach((cell, index) => text(cell, told[index]));
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
