/** One experiment: status, controls, results, campaigns. */

import { isOpen, saveBlob } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { clause, count, figure, percent, plural, rate, span, when } from "../format.js";
import { go, link, rewrite } from "../router.js";
import { colour } from "../theme.js";
import { chart, intervals, inWords } from "../parts/charts.js";
import { badge, callout, facts, meter, NAMES, sure, thresholds } from "../parts/elements.js";
import { findingsSection, PAIRS, THRESHOLDS } from "./experiment/findings.js";
import { loadWhenFinished, plainRow, pValue, sentence, tableOf, tested } from "./experiment/tables.js";

export async function show(main, context, { parts: [, id], query }) {
  context.title("Experiment");
  const path = `experiments/${encodeURIComponent(id)}`;
  const name = h("h1", null, "Experiment");
  const state = badge("pending", "");
  const actions = h("div.actions.push");
  const done = meter("Simulations");
  const told = facts();
  const notes = h("div");
  const scoring = h("p.scoring", { role: "status" });
  const results = resultsSection(context, query, () => whole.thresholds);
  const members = membersTable();
  replace(main, h("p.crumb", null, h("a", { href: link("experiments") }, "Experiments")),
    h("div.head", null, name, state, actions), notes,
    h("div.stack", null, h("section.card.standing", { "aria-label": "Progress" }, done, told), scoring, results,
      h("section.card", { "aria-labelledby": "members" }, h("h2", { id: "members" }, "Campaigns"), members)));

  const loading = loadWhenFinished(`${path}/results`, context, scoring, results.update);
  const found = [THRESHOLDS, PAIRS].map((kind) => [kind, findingsSection(kind, path, context)]);
  results.before(...found.map(([, section]) => section));
  const want = () => {
    if (whole === null || finished === null) return;
    loading.want(finished);
    for (const [kind, section] of found) {
      if (whole.body[kind.name]) section.want(finished);
    }
  };
  let whole = null; // the experiment with its campaigns
  let finished = null; // how many of them have finished
  const looking = context.watch(path, (read) => {
    whole = read;
    context.title(read.name);
    text(name, read.name);
    members.update(read.members);
    want();
  }, { busy: (read) => read.status === "running" });
  let drawn = null;
  const progressing = context.watch(`${path}/progress`, (read) => {
    state.update(read.status);
    done.update(read.budget ? read.simulations / read.budget : 0, !isOpen(read.status));
    told.update(figuresOf(read));
    warn(notes, read);
    const may = JSON.stringify([read.status, read.paused.length > 0]);
    if (drawn !== may) {
      drawn = may;
      replace(actions, steering(read, context, path, () => {
        looking.now();
        progressing.now();
      }));
    }
    finished = read.finished;
    want();
  }, { busy: (read) => read.status === "running" });
}

function figuresOf(read) {
  const open = isOpen(read.status);
  return {
    "Campaigns finished": `${count(read.finished)} of ${count(read.campaigns)}`,
    Simulations: `${count(read.simulations)} of ${count(read.budget)}`,
    Failed: count(read.failed),
    ...(open ? { "Time left": span(read.remaining_s), Queued: count(read.queued), Leased: count(read.leased), "Live workers": count(read.workers) } : {}),
    ...(read.cached ? { "From the cache": count(read.cached) } : {}),
    ...(read.deleted ? { Deleted: count(read.deleted) } : {}),
    ...(read.quarantined ? { "In quarantine": count(read.quarantined) } : {}),
    Rate: rate(read.rate_per_s), [open ? "So far" : "Took"]: span(read.elapsed_s), Submitted: when(read.created_at),
  };
}

function warn(place, read) {
  const told = JSON.stringify([read.paused, read.trouble, read.status === "running" && read.workers === 0]);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place,
    read.trouble && callout("bad", `The database currently rejects writes: ${clause(read.trouble)}. No acknowledged result is lost.`),
    read.status === "running" && read.workers === 0 && callout("warn", "The experiment is running, but no worker is. ", h("a", { href: link("workers") }, "How to start one")),
    read.paused.length > 0 && callout("warn", `${plural(read.paused.length, "campaign")} ${read.paused.length === 1 ? "is" : "are"} paused:`,
      h("ul.reasons", null, pausedFor(read.paused).map(([reason, ids]) => h("li", null, `${reason}: `,
        ids.map((id, index) => [index > 0 && ", ", h("a", { href: link("campaigns", id) }, id)]))))));
}

/** Return the reasons why campaigns are paused, each with the ids of the campaigns. */
function pausedFor(told) {
  const found = new Map();
  for (const one of told) {
    const [id, ...rest] = one.split(": ");
    const reason = rest.join(": ");
    found.set(reason, [...(found.get(reason) ?? []), id]);
  }
  return [...found];
}

function steering(read, context, path, look) {
  const act = async (method, way, said) => {
    const answer = await context.act(method, path + way, said);
    look();
    return answer;
  };
  const button = (words, doing, kind) => h(kind ? `button.${kind}` : "button", { type: "button", onclick: doing }, words);
  const open = isOpen(read.status);
  return [
    context.may.steer && read.status === "running" && button("Pause", () => act("POST", "/pause", "The experiment is paused; results of running jobs are still accepted.")),
    context.may.steer && read.paused.length > 0 && button("Resume", () => act("POST", "/resume", "The experiment is running again.")),
    context.may.steer && open && button("Cancel", async () => {
      if (await sure("Cancel the campaigns that have not ended? Their results are kept, but they cannot be resumed.", { yes: "Cancel experiment" })) await act("POST", "/cancel", "The experiment has been cancelled.");
    }),
    h("a.button", { href: link("campaigns", { experiment: read.id }) }, "Show campaigns"),
    context.may.remove && !open && button("Delete", async () => {
      const question = `Delete ${read.name} with its ${plural(read.campaigns - read.deleted, "campaign")} and all results? This cannot be undone.`;
      if ((await sure(question, { yes: "Delete" })) && (await context.act("DELETE", path, "The experiment has been deleted.")) === null) go("experiments");
    }, "quiet"),
  ];
}

function membersTable() {
  const body = h("tbody");
  const node = h("div.scroll.members", { tabindex: 0, role: "region", "aria-label": "Campaigns of the experiment" }, h("table", null,
    h("caption.read-out", null, "Campaigns of the experiment"),
    h("thead", null, h("tr", null, ["Campaign", "Method", "Problem", "Status"].map((words) => h("th", { scope: "col" }, words)),
      ["Seed", "Simulations", "Unsafe", "Failed"].map((words) => h("th.right", { scope: "col" }, words)))), body));
  node.update = (members) => keyed(body, members, (one) => one.campaign, memberRow);
  return node;
}

function memberRow(first) {
  const state = badge(first.status);
  const reason = h("div.small.muted");
  const [seed, simulations, unsafe, failed] = Array.from({ length: 4 }, () => h("td.right"));
  const node = h("tr", null, h("th", { scope: "row" }, h("a", { href: link("campaigns", first.campaign) }, first.campaign)),
    h("td", null, first.method), h("td", null, first.problem), h("td", null, state, reason), seed, simulations, unsafe, failed);
  node.update = (one) => {
    state.update(one.status);
    text(reason, one.status_reason);
    text(seed, one.seed);
    text(simulations, count(one.simulations));
    text(unsafe, one.simulations > one.failed ? `${count(one.unsafe)} (${percent(one.unsafe / (one.simulations - one.failed))})` : "–");
    text(failed, count(one.failed));
  };
  node.update(first);
  return node;
}

const METHOD = [
  ["DBS", "counts solutions with a fitness of at most t_b, selected greedily, best first, each at least d_th from all those already selected. Simulations beyond the budget, which complete the last generation, are not counted."],
  ["Strict DBS", "counts only those distinct boundary solutions whose interval contains the threshold probability and whose neighbourhood has both verdicts. At large t_b, plain DBS also counts neighbourhoods without unsafe solutions."],
  ["A control", "keeps the simulated solutions and redraws each verdict with the unsafe probability of its scenario alone. What a method reaches beyond its control is due to behaviour. A control with few behaviours per scenario is too low: exceeding it proves nothing."],
  ["Tests", "are two-sided Mann-Whitney U tests with Holm's correction over all comparisons of this problem and measure, at all thresholds where values differ. Vargha and Delaney's A12 is the probability that the first exceeds the second: small from .56, medium from .64, large from .71, and symmetrically below one half."],
];

/** Return the section of results; ``update(results)`` shows other results. ``defaults()`` returns the default thresholds. */
function resultsSection(context, query, defaults) {
  const choose = thresholds(query, () => draw());
  const problem = h("select", { onchange: () => { rewrite({ problem: problem.value }); draw(); } });
  const problemLabel = h("label", null, "Problem ", problem);
  const controls = h("input", { type: "checkbox", onchange: () => draw() });
  const partial = h("div");
  const words = h("ul.sentences");
  const heading = h("h2");
  const dots = intervals("Means with 95% intervals");
  const standings = standingsTable();
  const curve = growth("DBS against the fraction of the budget; the final values are in the table of means", context);
  const duels = duelsTable();
  const repeats = repeatsTable();
  const save = h("button", { type: "button", onclick: () => saveResults(results) }, "Results as JSON");
  const node = h("section.stack.results", { hidden: true, "aria-label": "Results" }, partial,
    h("div.inline", null, choose, problemLabel, h("span.push", null, save)),
    h("div.card", null, heading, words),
    h("div.grid-2", null,
      h("div.card", null, h("h2", null, "Means and 95% intervals"), dots, h("p.hint", null, "Filled: methods. Hollow: controls. Thin strokes: individual repeats.")),
      h("div.card", null, h("h2", null, "Convergence"), curve, h("p.hint", null, "Means over the repeats; each point counts only solutions evaluated by then. Bands: lowest to highest repeat."),
        h("label.check", null, controls, "Show controls"))),
    h("div.card", null, h("h2", null, "Figures"), standings),
    h("div.card", null, h("h2", null, "Comparisons"), duels),
    h("div.card.repeats", null, h("h2", null, "Repeats"), repeats),
    h("details.card", null, h("summary", null, "Method"), h("dl.method", null, METHOD.map(([term, told]) => [h("dt", null, term), h("dd", null, told)]))));
  let results = null;

  function draw() {
    const chosen = { ...choose.chosen, name: NAMES[choose.chosen.measure] };
    const rows = standingsAt(results, problem.value, chosen);
    const compared = duelsAt(results, problem.value, chosen);
    text(heading, `Conclusions at t_b ${figure(chosen.t_b)}, d_th ${figure(chosen.d_th)}`);
    const said = sentences(compared, rows, chosen);
    keyed(words, said.length ? said : [["", nothingToCompare(results, problem.value, chosen)]], ([key]) => key, sentence);
    dots.update(rows, `Means of ${chosen.name} with 95% intervals: ${rows.map((row) => `${row.label} ${inWords(row)}`).join("; ")}`);
    standings.update(rows);
    curve.update(results.fractions, growthAt(results, problem.value, chosen),
      controls.checked ? growthAt(results, problem.value, chosen, { control: true }).filter((line) => line.means[0] !== null) : []);
    duels.update(compared);
    repeats.update(results.repeats.filter((one) => one.problem === problem.value), chosen);
  }

  node.update = (next) => {
    results = next;
    node.hidden = next.scored === 0;
    if (next.scored === 0) return;
    choose.update({ ...defaults(), t_bs: next.t_bs, d_ths: next.d_ths });
    const problems = problemsOf(next);
    const before = problem.value || query.get("problem");
    keyed(problem, problems, String, (name) => h("option", { value: name }, name));
    problem.value = problems.includes(before) ? before : problems[0];
    problemLabel.hidden = problems.length < 2;
    replace(partial, next.scored < next.campaigns && callout("warn",
      `${count(next.scored)} of ${plural(next.campaigns, "campaign")} ${next.scored === 1 ? "has" : "have"} finished: the tables are preliminary.`));
    draw();
  };
  return node;
}

/** Return why there are no comparisons at the chosen thresholds. */
function nothingToCompare(results, problem, chosen) {
  const at = new Set(results.duels.filter((one) => one.problem === problem).map((one) => one.d_th));
  if (at.size === 0) return "There is nothing to compare: only one method, and no control.";
  return `Methods are compared at d_th ${[...at].map((d_th) => figure(d_th)).join(", ")}, the distances in the paper's tables, and not at ${figure(chosen.d_th)}.`;
}

/** Return the conclusion of each comparison: its key, the names, the numbers, the sentence. */
function sentences(duels, rows, chosen) {
  const means = new Map(rows.map((row) => [row.key, row.mean]));
  return duels.map((one) => {
    const [first, second] = [means.get(`${one.first} false`), means.get(`${one.second} ${one.control}`)];
    const beside = one.control ? " compared with its control" : ` and ${one.second}`;
    return [`${one.first}:${one.second}:${one.control}`, one.first + beside,
      `: ${chosen.name} ${first.toFixed(1)} against ${second.toFixed(1)}${tested(one)}; `, `${one.says}.`];
  });
}

function standingsTable() {
  const node = tableOf("Means and 95% intervals", [["Method"], ["Mean", 1], ["95% interval", 1], ["Repeats", 1], ["Unsafe", 1], ["Behaviours per scenario", 1]]);
  const say = (row) => [row.label, row.mean.toFixed(1), row.low === null ? "–" : `${Math.max(0, row.low).toFixed(1)} to ${row.high.toFixed(1)}`,
    count(row.repeats), percent(row.unsafe_share), row.control ? `${row.behaviours.toFixed(1)}${row.reads_low ? ", too low" : ""}` : "–"];
  node.update = (rows) => keyed(node.body, rows, (row) => row.key, plainRow(say, [1, 1, 1, 1, 1]));
  return node;
}

function duelsTable() {
  const table = tableOf("Comparisons of methods with each other and with their controls",
    [["First"], ["Second"], ["U", 1], ["p", 1], ["p corrected", 1], ["A12", 1], ["Effect"], ["Differ"], ["Conclusion"]]);
  const none = h("p.muted", { hidden: true }, "Nothing to compare.");
  const node = h("div", null, table, none);
  const say = (one) => [one.first, one.control ? "its control" : one.second, figure(one.u), pValue(one.p), pValue(one.p_holm), one.a12.toFixed(2), one.p === null ? "equal" : one.effect,
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
  const node = tableOf("Each finished campaign at the full budget", [["Campaign"], ["Method"], ["Seed", 1], ["Evaluated", 1], ["Unsafe", 1], ["Score", 1], ["Control", 1], ["Behaviours per scenario", 1]]);
  node.update = (repeats, chosen) => {
    const at = (source) => source[chosen.measure].at(-1)[chosen.i][chosen.j];
    const rows = repeats.map((one) => ({
      id: one.campaign,
      cells: [one.method, one.seed, count(one.evaluated), percent(one.unsafe / Math.max(1, one.evaluated)), figure(at(one)), one.control ? figure(at(one.control)) : "–",
        one.control ? `${one.control.behaviours_a_scenario.toFixed(1)}${one.control.reads_low ? ", too low" : ""}` : "–"],
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

/** Colours of methods, in order; they repeat after the last. */
const HUES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];

/** Return the names of the problems, in order. */
function problemsOf(results) {
  return [...new Set(results.repeats.map((repeat) => repeat.problem))];
}

/** Return the methods of a problem with their colours, in order. */
function methodsOf(results, problem) {
  const names = new Set(results.repeats.filter((repeat) => repeat.problem === problem).map((repeat) => repeat.method));
  return [...names].map((method, index) => ({ method, colour: HUES[index % HUES.length] }));
}

/** Return a row for each method and each control: mean, interval, single values, unsafe share. */
function standingsAt(results, problem, { measure, t_b, d_th, i, j }) {
  const colours = new Map(methodsOf(results, problem).map(({ method, colour }) => [method, colour]));
  return results.standings
    .filter((one) => one.problem === problem && one.measure === measure && one.t_b === t_b && one.d_th === d_th)
    .map((one) => {
      const repeats = results.repeats.filter((repeat) => repeat.problem === problem && repeat.method === one.method);
      const sources = one.control ? repeats.map((repeat) => repeat.control).filter(Boolean) : repeats;
      return {
        ...one, key: `${one.method} ${one.control}`, label: one.control ? `${one.method}, control` : one.method,
        hollow: one.control, colour: colours.get(one.method), values: sources.map((source) => source[measure].at(-1)[i][j]),
        unsafe_share: average(sources.map((source) => (one.control ? source.unsafe_share : source.unsafe / Math.max(1, source.evaluated)))),
        behaviours: one.control ? average(sources.map((source) => source.behaviours_a_scenario)) : null,
        reads_low: one.control && sources.some((source) => source.reads_low),
      };
    });
}

/** Return the mean, the minimum and the maximum of each method, or each control, at each fraction of the budget. */
function growthAt(results, problem, { measure, i, j }, { control = false } = {}) {
  return methodsOf(results, problem).map(({ method, colour }) => {
    const repeats = results.repeats.filter((repeat) => repeat.problem === problem && repeat.method === method);
    const sources = control ? repeats.map((repeat) => repeat.control).filter(Boolean) : repeats;
    const columns = results.fractions.map((_, place) => sources.map((source) => source[measure][place][i][j]));
    return {
      method, colour, means: columns.map(average), least: columns.map((column) => Math.min(...column)),
      most: columns.map((column) => Math.max(...column)),
    };
  });
}

/** Return the comparisons of a problem at the chosen thresholds. */
function duelsAt(results, problem, { measure, t_b, d_th }) {
  return results.duels.filter((one) => one.problem === problem && one.measure === measure && one.t_b === t_b && one.d_th === d_th);
}

function average(values) {
  return values.length ? values.reduce((total, value) => total + value, 0) / values.length : null;
}

const DASHES = [[], [8, 4], [2, 3], [10, 4, 2, 4], [5, 5], [14, 4]];

/** Return the chart of convergence curves: means in bands of the repeats; ``update(fractions, lines, controls)`` draws it. */
function growth(label, context) {
  const place = h("div");
  let known = null;
  let drawn = null;
  let bands = [];
  let own = null;

  place.update = (fractions, lines, controls) => {
    const told = JSON.stringify([lines.map((line) => line.method), controls.map((line) => line.method)]);
    if (told !== known) {
      known = told;
      own?.abort();
      own = new AbortController();
      context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
      drawn = chart({
        label, x: "fraction of the budget", signal: own.signal, height: 260,
        series: [...lines.map((line, index) => ({ label: line.method, colour: line.colour, dash: DASHES[index % DASHES.length], points: true })),
          ...controls.map((line) => ({ label: `${line.method}, control`, colour: line.colour, width: 1, dash: [3, 3] }))],
        options: {
          scales: { x: { time: false, range: [0, 1.02] }, y: { range: (plot, least, most) => [0, Math.max(1, most ?? 1, ...bands.flatMap((band) => band.most)) * 1.04] } },
          axes: [{ values: (plot, splits) => splits.map(percent) }, {}],
          hooks: { drawClear: [(plot) => drawBands(plot, fractions, bands)] },
        },
      });
      replace(place, drawn);
    }
    bands = lines;
    drawn.update([fractions, ...lines.map((line) => line.means), ...controls.map((line) => line.means)]);
  };
  return place;
}

function drawBands(plot, fractions, bands) {
  const canvas = plot.ctx;
  const x = (value) => plot.valToPos(value, "x", true);
  const y = (value) => plot.valToPos(value, "y", true);
  canvas.save();
  canvas.globalAlpha = 0.14;
  for (const band of bands) {
    canvas.fillStyle = colour(band.colour);
    canvas.beginPath();
    fractions.forEach((share, index) => canvas.lineTo(x(share), y(band.most[index])));
    [...fractions].reverse().forEach((share, index) => canvas.lineTo(x(share), y(band.least[fractions.length - 1 - index])));
    canvas.fill();
  }
  canvas.restore();
}
