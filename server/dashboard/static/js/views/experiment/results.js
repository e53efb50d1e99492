/** What an experiment found: sentences, standings, growth, duels, single repeats. */

import { attribute, h, keyed, replace, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { intervals, inWords } from "../../parts/intervals.js";
import { callout } from "../../parts/callout.js";
import { saveBlob } from "../../api.js";
import { NAMES, thresholds } from "../../parts/thresholds.js";
import { link, rewrite } from "../../router.js";
import { duelsAt, growthAt, methodsOf, problemsOf, pValue, standingsAt } from "./figures.js";
import { growth } from "./growth.js";

const METHOD = [
  ["DBS", "counts solutions whose fitness is at most t_b, taken greedily, best first, each at least d_th from all taken before. What was simulated beyond the budget, to end a generation, is not counted."],
  ["Strict DBS", "counts only solutions whose interval holds the threshold probability and whose neighbourhood holds both verdicts. Up from t_b 1/9 plain DBS counts surroundings in which nothing unsafe was ever seen."],
  ["A control", "keeps what was simulated and redraws each verdict with the probability that its scenario alone has. What a method reaches beyond its control is owed to behaviour. A control with few behaviours a scenario reads low: what lies beyond it proves nothing."],
  ["Tests", "are Mann-Whitney U, two-sided, with Holm's correction over all comparisons of this problem and measure, at all thresholds, in which values differ at all. A12 of Vargha and Delaney says how often the first exceeds the second: small from .56, medium from .64, large from .71, and the same below one half."],
];

/** Return the section; its ``update(results)`` shows other results. */
export function resultsSection(context, query) {
  const choose = thresholds(query, () => draw());
  const problem = h("select", { onchange: () => { rewrite({ problem: problem.value }); draw(); } });
  const problemLabel = h("label", null, "Problem ", problem);
  const controls = h("input", { type: "checkbox", onchange: () => draw() });
  const partial = h("div");
  const words = h("ul.sentences");
  const heading = h("h2");
  const dots = intervals("Means with 95% intervals");
  const standings = standingsTable();
  const course = growth("Growth over the budget: the figures at its end are in the table of means", context);
  const duels = duelsTable();
  const repeats = repeatsTable();
  const save = h("button", { type: "button", onclick: () => saveResults(results) }, "Results as JSON");
  const node = h("section.stack.results", { hidden: true, "aria-label": "Results" }, partial,
    h("div.inline", null, choose, problemLabel, h("span.push", null, save)),
    h("div.card", null, heading, words),
    h("div.grid-2", null,
      h("div.card", null, h("h2", null, "Means and 95% intervals"), dots, h("p.hint", null, "Filled: a method. Hollow: its control. Thin strokes: single repeats.")),
      h("div.card", null, h("h2", null, "Growth"), course, h("p.hint", null, "Means of the repeats, each share scored with what was known then; bands run from the least repeat to the most."),
        h("label.check", null, controls, "Show controls, too"))),
    h("div.card", null, h("h2", null, "Figures"), standings),
    h("div.card", null, h("h2", null, "Compared"), duels),
    h("div.card.repeats", null, h("h2", null, "Repeats"), repeats),
    h("details.card", null, h("summary", null, "How it was computed"), h("dl.method", null, METHOD.map(([term, told]) => [h("dt", null, term), h("dd", null, told)]))));
  let results = null;

  function draw() {
    const chosen = { ...choose.chosen, name: NAMES[choose.chosen.measure] };
    const rows = standingsAt(results, problem.value, chosen);
    const compared = duelsAt(results, problem.value, chosen);
    text(heading, `What it says at t_b ${figure(chosen.t_b)}, d_th ${figure(chosen.d_th)}`);
    const said = sentences(compared, rows, chosen);
    keyed(words, said.length ? said : [["", "One method alone, without a control: there is nothing to compare."]], ([key]) => key, sentence);
    dots.update(rows, `Means of ${chosen.name} with 95% intervals: ${rows.map((row) => `${row.label} ${inWords(row)}`).join("; ")}`);
    standings.update(rows);
    course.update(results.fractions, growthAt(results, problem.value, chosen),
      controls.checked ? growthAt(results, problem.value, chosen, { control: true }).filter((line) => line.means[0] !== null) : []);
    duels.update(compared);
    repeats.update(results.repeats.filter((one) => one.problem === problem.value), chosen);
  }

  node.update = (next) => {
    results = next;
    node.hidden = next.scored === 0;
    if (next.scored === 0) return;
    choose.update(next);
    const problems = problemsOf(next);
    const before = problem.value || query.get("problem");
    keyed(problem, problems, String, (name) => h("option", { value: name }, name));
    problem.value = problems.includes(before) ? before : problems[0];
    problemLabel.hidden = problems.length < 2;
    replace(partial, next.scored < next.campaigns && callout("warn",
      `${count(next.scored)} of ${plural(next.campaigns, "campaign")} ${next.scored === 1 ? "has" : "have"} finished: the tables are of ${next.scored === 1 ? "it" : "those"} alone, and will change.`));
    draw();
  };
  return node;
}

/** Return what each duel says: its key, the names, the figures and the conclusion. */
function sentences(duels, rows, chosen) {
  const means = new Map(rows.map((row) => [row.key, row.mean]));
  return duels.map((one) => {
    const [first, second] = [means.get(`${one.first} false`), means.get(`${one.second} ${one.control}`)];
    const beside = one.control ? " beside its control" : ` and ${one.second}`;
    return [`${one.first}:${one.second}:${one.control}`, one.first + beside,
      `: ${chosen.name} ${first.toFixed(1)} against ${second.toFixed(1)}, A12 ${one.a12.toFixed(2)} (${one.effect}), p ${pValue(one.p)}, corrected ${pValue(one.p_holm)}; `, `${one.says}.`];
  });
}

function sentence(first) {
  const who = h("strong");
  const figures = h("span");
  const says = h("span");
  const node = h("li", null, who, figures, says);
  node.update = ([, names, told, concluded]) => {
    text(who, names);
    text(figures, told);
    text(says, concluded);
  };
  node.update(first);
  return node;
}

function tableOf(label, columns) {
  const body = h("tbody");
  const node = h("div.scroll", { tabindex: 0, role: "region", "aria-label": label },
    h("table", null, h("caption.read-out", null, label), h("thead", null, h("tr", null, columns.map(([words, right]) =>
      h("th", { scope: "col", class: right ? "right" : null }, words)))), body));
  node.body = body;
  return node;
}

/** Return a table row of so many cells after its heading; ``update(item)`` fills them by ``say``. */
function plainRow(say, rights) {
  return (first) => {
    const name = h("th", { scope: "row" });
    const cells = rights.map((right) => h(right ? "td.right" : "td"));
    const node = h("tr", null, name, cells);
    node.update = (item) => [name, ...cells].forEach((cell, index) => text(cell, say(item)[index]));
    node.update(first);
    return node;
  };
}

function standingsTable() {
  const node = tableOf("Means and 95% intervals", [["Method"], ["Mean", 1], ["95% interval", 1], ["Repeats", 1], ["Unsafe", 1], ["Behaviours a scenario", 1]]);
  const say = (row) => [row.label, row.mean.toFixed(1), row.low === null ? "–" : `${Math.max(0, row.low).toFixed(1)} to ${row.high.toFixed(1)}`,
    count(row.repeats), percent(row.unsafe_share), row.control ? `${row.behaviours.toFixed(1)}${row.reads_low ? ", reads low" : ""}` : "–"];
  node.update = (rows) => keyed(node.body, rows, (row) => row.key, plainRow(say, [1, 1, 1, 1, 1]));
  return node;
}

function duelsTable() {
  const table = tableOf("Methods compared, each with the others and with its control",
    [["First"], ["Second"], ["U", 1], ["p", 1], ["p corrected", 1], ["A12", 1], ["Effect"], ["Differ"], ["What it says"]]);
  const none = h("p.muted", { hidden: true }, "Nothing to compare.");
  const node = h("div", null, table, none);
  const say = (one) => [one.first, one.control ? "its control" : one.second, figure(one.u), pValue(one.p), pValue(one.p_holm), one.a12.toFixed(2), one.effect,
    one.differs ? "yes" : "no", one.says];
  const row = plainRow(say, [0, 1, 1, 1, 1, 0, 0, 0]);
  node.update = (duels) => {
    keyed(table.body, duels, (one) => `${one.first}:${one.second}:${one.control}`, (one) => {
      const made = row(one);
      const fill = made.update;
      made.lastElementChild.classList.add("says");
      made.update = (item) => {
        fill(item);
        attribute(made, "class", item.differs ? "differs" : null);
      };
      made.update(one);
      return made;
    });
    table.hidden = duels.length === 0;
    none.hidden = duels.length > 0;
  };
  return node;
}

function repeatsTable() {
  const node = tableOf("Each finished campaign at the whole budget", [["Campaign"], ["Method"], ["Seed", 1], ["Evaluated", 1], ["Unsafe", 1], ["It reached", 1], ["Its control", 1], ["Behaviours a scenario", 1]]);
  node.update = (repeats, chosen) => {
    const at = (source) => source[chosen.measure].at(-1)[chosen.i][chosen.j];
    const rows = repeats.map((one) => ({
      id: one.campaign,
      cells: [one.method, one.seed, count(one.evaluated), percent(one.unsafe / Math.max(1, one.evaluated)), figure(at(one)), one.control ? figure(at(one.control)) : "–",
        one.control ? `${one.control.behaviours_a_scenario.toFixed(1)}${one.control.reads_low ? ", reads low" : ""}` : "–"],
    }));
    keyed(node.body, rows, (row) => row.id, (first) => {
      const cells = first.cells.map((_, index) => h(index ? "td.right" : "td"));
      const made = h("tr", null, h("th", { scope: "row" }, h("a", { href: link("campaigns", first.id) }, first.id)), cells);
      made.update = (row) => cells.forEach((cell, index) => text(cell, row.cells[index]));
      made.update(first);
      return made;
    });
  };
  return node;
}

function saveResults(results) {
  saveBlob(new Blob([`${JSON.stringify(results, null, 1)}\n`], { type: "application/json" }), `results-${results.id}.json`);
}
