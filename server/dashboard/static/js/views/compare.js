/** Campaigns side by side: what each found of what they searched for, convergence curves, differences in their settings. */

import { ApiError, get, isOpen, rowsOf } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { capital, count, figure, minus, percent, plainId } from "../format.js";
import { loadOnNews, withRetries, poll, whenMade } from "../polling.js";
import { link, rewrite } from "../router.js";
import { chart } from "../parts/charts.js";
import { callout, matrix, NAMES, segments, thresholds } from "../parts/elements.js";

const HUES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];
const FITNESS = [["best_fitness", "Best"], ["median_fitness", "Median"]];
const ALL_SAFE = "At large t_b, DBS also counts neighbourhoods without unsafe solutions; strict DBS, a part of DBS, does not.";

export async function show(main, context, { query }) {
  context.title("Compare campaigns");
  const wanted = (query.get("ids") ?? "").split(",").map((id) => id.trim()).filter((id) => /^[0-9a-z]+$/.test(id));
  const asked = [...new Set(wanted)];
  let ids = asked.slice(0, MOST);
  const followed = new Map();
  let fitness = "best_fitness";
  let due = false;

  const page = pageOf(context, query, changed, (taken) => { fitness = taken; changed(); });
  const picks = picker(context, () => ids, choose);
  const choosing = h("details.card.choosing", { open: ids.length < 2 }, h("summary", null, "Choose campaigns"), picks);
  replace(main, h("div.head", null, h("h1", null, "Compare campaigns")),
    asked.length > MOST && callout("warn", `${count(asked.length)} campaigns were requested; only the first ${MOST} are compared.`),
    choosing, page.chips, page.nodes);
  choose(ids);

  function choose(next) {
    ids = next.slice(0, MOST);
    rewrite({ ids: ids.join(",") });
    for (const [id, one] of followed) {
      if (ids.includes(id)) continue;
      one.leave();
      followed.delete(id);
    }
    for (const id of ids) {
      if (followed.has(id)) continue;
      const taken = [...followed.values()].map((one) => one.colour);
      followed.set(id, Object.assign(follow(id, context, changed), { colour: HUES.find((hue) => !taken.includes(hue)) }));
    }
    picks.update();
    changed();
  }

  /** Schedule a drawing; changes that arrive before it are drawn together. */
  function changed() {
    if (due) return;
    due = true;
    setTimeout(() => {
      due = false;
      if (!context.signal.aborted) page.draw(named(ids.map((id) => followed.get(id))), fitness, (id) => choose(ids.filter((other) => other !== id)));
    }, 0);
  }
}

/** Give each campaign its name, with the id appended if two have the same name. */
function named(all) {
  const names = all.map((one) => one.campaign?.name);
  return all.map((one, index) => ({
    ...one, name: !one.campaign ? one.id : names.indexOf(names[index]) === names.lastIndexOf(names[index]) ? names[index] : `${names[index]} ${one.id}`,
  }));
}

function pageOf(context, query, changed, chooseFitness) {
  const choice = thresholds(query, changed);
  const chips = h("ul.chips", { "aria-label": "Compared campaigns" });
  const few = h("p.empty");
  let complete = false; // whether there is something to show of each campaign
  const notes = h("div");
  const facts = matrix("Campaigns and their results", "Property", { right: false });
  const dbs = convergenceChart("DBS against the number of simulations", context, { scales: { x: { time: false }, y: { range: fromNought } } });
  const dbsHeading = h("h2");
  const dbsHint = h("p.hint");
  const fitness = convergenceChart("Fitness against the number of simulations", context);
  const which = segments("Fitness", chooseFitness, FITNESS, "best_fitness");
  const gridHeading = h("h2");
  const grid = matrix("DBS, and strict DBS in brackets, by t_b", "Campaign", { right: true });
  const gridHint = h("p.hint");
  const says = h("ul.sentences");
  const settings = matrix("Settings that differ", "Setting", { right: false });
  const same = h("p.muted");
  const dbsCard = h("div.card", null, dbsHeading, dbs, dbsHint);
  const gridCard = h("div.card", null, gridHeading, grid, says, gridHint);
  const fitnessCard = h("div.card", null, h("div.inline.between", null, h("h2", null, "Fitness"), which), fitness, h("p.hint", null, "The quantity that each algorithm minimises; scales of different algorithms may differ."));
  const curves = h("div.grid-2", null, dbsCard, fitnessCard);
  const shown = h("div.stack", null, notes, choice,
    h("div.card", null, h("h2", null, "Side by side"), facts),
    curves,
    gridCard,
    h("div.card", null, h("h2", null, "Settings that differ"), settings, same));

  function draw(all, fitnessName, take) {
    keyed(chips, all, (one) => one.id, (one) => chip(one, take));
    complete ||= all.every((one) => one.trouble || (one.campaign && one.progress && one.findings));
    shown.hidden = all.length < 2 || !complete;
    few.hidden = !shown.hidden;
    text(few, all.length === 0 ? "Choose at least two campaigns." : all.length === 1 ? "Choose one more campaign." : "Loading …");
    if (shown.hidden) return;
    const limits = all.find((one) => one.campaign)?.campaign.thresholds;
    if (limits) choice.update(limits);
    const chosen = choice.chosen;
    const columns = all.map((one) => ({ key: `${one.id} ${one.name}`, head: () => h("span", null, swatch(one.colour), h("a", { href: link("campaigns", one.id) }, one.name)) }));
    note(notes, all);
    const boundary = all.filter(searchesBoundary);
    for (const node of [choice, dbsCard, gridCard]) node.hidden = boundary.length === 0;
    const minimising = all.filter((one) => begun(one) && one.progress.minimises);
    fitnessCard.hidden = minimising.length === 0;
    curves.hidden = dbsCard.hidden && fitnessCard.hidden;
    facts.update(columns, [...factRows(all), ...foundRows(all), ...(boundary.length ? boundaryRows(all, chosen) : [])]);
    text(dbsHeading, chosen.measure === "strict" ? "Strict DBS against the number of simulations" : "DBS against the number of simulations");
    const usual = all.find((one) => one.progress)?.progress;
    text(dbsHint, usual ? `After each generation, at t_b ${figure(usual.t_b)}, d_th ${figure(usual.d_th)}.` : "");
    const series = chosen.measure === "strict" ? "strict_dbs" : "dbs";
    dbs.update(boundary.filter(begun).map((one) => lineOf(one, series)));
    which.update(FITNESS, fitnessName);
    fitness.update(minimising.map((one) => lineOf(one, fitnessName)));
    text(gridHeading, `DBS within the budget at d_th ${figure(chosen.d_th)}, strict DBS in brackets`);
    const draws = all.find((one) => one.scores?.control)?.scores.draws;
    text(gridHint, `${draws ? `Controls: verdicts redrawn independently of behaviour; means of ${draws} draws. ` : ""}${ALL_SAFE}`);
    grid.update([{ key: "unsafe", head: "unsafe within the budget" }, ...(limits?.t_bs ?? []).map((t_b) => ({ key: t_b, head: `t_b ${figure(t_b)}` }))], gridRows(boundary, limits?.t_bs ?? [], chosen.j));
    keyed(says, boundary.filter((one) => one.scores?.says.length), (one) => one.id, (first) => {
      const node = h("li");
      node.update = (one) => text(node, `${one.name}: ${one.scores.says[choice.chosen.i][choice.chosen.j]}.`);
      node.update(first);
      return node;
    });
    const ready = all.filter((one) => one.campaign);
    const rows = differences(ready.map((one) => one.campaign));
    settings.hidden = rows.length === 0;
    settings.update(ready.map((one) => ({ key: `${one.id} ${one.name}`, head: one.name })), rows);
    text(same, rows.length ? "" : "None: the campaigns differ in name only.");
  }

  return { chips, nodes: [few, shown], draw };
}

function chip(first, take) {
  const name = h("a", { href: link("campaigns", first.id) });
  const away = h("button.quiet", { type: "button", onclick: () => take(first.id) }, "×");
  const node = h("li.chip", null, swatch(first.colour), name, away);
  node.update = (one) => {
    text(name, one.name);
    attribute(away, "aria-label", `Remove ${one.name}`);
  };
  node.update(first);
  return node;
}

function swatch(colour) {
  const node = h("i.swatch", { "aria-hidden": "true" });
  node.style.background = `var(${colour})`;
  return node;
}

function note(place, all) {
  const bodies = all.map((one) => one.campaign?.body).filter(Boolean);
  const problems = new Set(bodies.map((body) => body.problem.id));
  const worlds = new Set(bodies.map((body) => JSON.stringify(body.problem)));
  const simulators = new Set(all.map((one) => one.campaign?.simulator).filter(Boolean));
  const budgets = new Set(all.map((one) => one.progress?.budget).filter(Boolean));
  const sought = new Set(all.flatMap((one) => soughtBy(one).map((found) => found.title.toLowerCase())));
  const words = [
    problems.size > 1 && ["warn", "The campaigns search different problems, so their results are not comparable."],
    problems.size === 1 && worlds.size > 1 && ["warn", "The problems of the campaigns have different parameters, which may explain differences."],
    simulators.size > 1 && ["warn", `The campaigns were simulated with different simulators (${[...simulators].join(", ")}), which may explain differences. Simulate them again with one simulator to compare anything else.`],
    problems.size === 1 && budgets.size > 1 && ["warn", "The budgets of the campaigns differ, so the totals are not comparable. The charts compare equal numbers of simulations."],
    sought.size > 1 && ["", `The campaigns search for different things: ${[...sought].join(", ")}. What a campaign did not search for, it may still have met.`],
    ...all.filter((one) => one.trouble).map((one) => ["bad", `${one.name}: ${one.trouble}`]),
  ].filter(Boolean);
  const told = JSON.stringify(words);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place, words.map(([kind, said]) => callout(kind, said)));
}

function rowOf(all, label, say) {
  return { key: label, label, cells: all.map((one) => say(one) ?? (one.trouble ? "–" : "loading")) };
}

/** Return the rows about the campaigns themselves. */
function factRows(all) {
  const row = (label, say) => rowOf(all, label, say);
  return [
    row("Problem", (one) => one.campaign && plainId(one.campaign.body.problem.id)),
    row("Simulator", (one) => one.campaign && (one.campaign.simulator ?? "none")),
    row("Algorithm", (one) => one.campaign?.body.algorithm.id),
    row("Seed", (one) => one.campaign && String(one.campaign.body.seed)),
    row("Status", (one) => one.progress?.status),
    row("Simulations", (one) => one.progress && `${count(one.progress.simulations)} of ${count(one.progress.budget)}`),
    row("Unsafe share", (one) => one.progress && percent(unsafeShare(one.progress))),
    row("Failed", (one) => one.progress && count(one.progress.failed + one.progress.reported_failed)),
  ];
}

/** Return the unsafe share of all results, also of those that the search has not received yet, as the page of a campaign does. */
function unsafeShare({ evaluated, reported, unsafe, reported_unsafe }) {
  return evaluated + reported ? (unsafe + reported_unsafe) / (evaluated + reported) : null;
}

/** Return what a campaign searched for; nothing until that is known. */
function soughtBy({ findings }) {
  return findings?.findings.filter((one) => one.role === "sought") ?? [];
}

/** Return a row for each key figure of what any of the campaigns searched for. */
function foundRows(all) {
  const kinds = new Set(all.flatMap((one) => soughtBy(one).map(({ kind }) => kind)));
  const rows = new Map();
  const stem = (words) => words.replace(/s\b/g, ""); // 1 pair, 2 pairs
  const figuresOf = (one) => one.findings?.findings.filter(({ kind }) => kinds.has(kind)).flatMap(({ figures }) => figures) ?? [];
  for (const { words } of all.flatMap(figuresOf)) {
    const known = rows.get(stem(words));
    if (!known || known.length < words.length) rows.set(stem(words), words);
  }
  return [
    rowOf(all, "Found", (one) => one.findings?.words),
    ...[...rows].map(([key, words]) => rowOf(all, capital(words), (one) => one.findings && (figuresOf(one).find((each) => stem(each.words) === key)?.term ?? "–"))),
  ];
}

/** Return the rows that only searches for the boundary have. */
function boundaryRows(all, { measure, t_b, d_th, i, j }) {
  const row = (label, say) => rowOf(all, label, say);
  const scored = (say, so_far) => (one) => (one.progress && !searchesBoundary(one) ? "–" : one.scores ? say(one.scores) : one.progress ? one.scoring || so_far?.(one) || "after the end" : null);
  const latest = (name) => ({ progress, generations }) => (progress.t_b === t_b && progress.d_th === d_th && generations.length > 0 ? `${count(generations.at(-1)[name])} so far` : "");
  const control = (say) => scored((scores) => (scores.control ? say(scores.control) : "none"));
  return [
    row("DBS within the budget", scored((scores) => figure(scores.dbs.at(-1)[i][j]), latest("dbs"))),
    row("Strict DBS within the budget", scored((scores) => figure(scores.strict.at(-1)[i][j]), latest("strict_dbs"))),
    row(`${NAMES[measure]} of the control`, control((blind) => figure(blind[measure].at(-1)[i][j]))),
    row("Behaviours per scenario", control((blind) => `${blind.behaviours_a_scenario.toFixed(1)}${blind.reads_low ? ", control too low" : ""}`)),
  ];
}

function gridRows(all, t_bs, j) {
  return all.flatMap((one) => {
    const rows = (source, share, extra) => [percent(share), ...source.dbs.at(-1).map((row, i) => `${figure(row[j])} (${figure(source.strict.at(-1)[i][j])})${extra}`)];
    if (!one.scores) return [{ key: `${one.id} ${one.name}`, label: one.name, cells: ["–", ...t_bs.map(() => (one.progress || one.trouble ? one.scoring || "–" : "loading"))] }];
    const blind = one.scores.control;
    return [
      { key: `${one.id} ${one.name} scored`, label: one.name, cells: rows(one.scores, one.scores.unsafe_share, "") },
      ...(blind ? [{ key: `${one.id} ${one.name} control`, class: "muted", label: `${one.name}, control${blind.reads_low ? " (too low)" : ""}`, cells: rows(blind, blind.unsafe_share, "") }] : []),
    ];
  });
}

/** Return whether DBS measures what a campaign searches for; unknown until its progress has been read. */
function searchesBoundary({ progress }) {
  return Boolean(progress?.finds[0] === "boundary");
}

function begun(one) {
  return one.generations.length > 0;
}

function lineOf(one, name) {
  const points = one.generations.filter((generation) => generation[name] !== null)
    .map((generation) => [generation.evaluated + generation.measured + generation.failed, generation[name]]);
  return { key: one.id, name: one.name, colour: one.colour, points };
}

function fromNought(plot, least, most) {
  return [0, Math.max(1, most ?? 1) * 1.05];
}

const DASHES = [[], [8, 4], [2, 3], [10, 4, 2, 4], [5, 5], [14, 4]];

/**
 * Return a step chart against the number of simulations, one line for each campaign; ``update(lines)`` draws ``{key, name, colour, points: [x, y][]}``.
 *
 * @param {string} label Description.
 * @param {object} context Of the view.
 * @param {object} options Of the chart: ``options`` as uPlot takes them.
 */
function convergenceChart(label, context, options = {}) {
  const place = h("div");
  let known = null;
  let own = null;
  let drawn = null;

  place.update = (lines) => {
    const told = JSON.stringify(lines.map((line) => [line.key, line.name, line.colour]));
    if (told !== known) {
      known = told;
      own?.abort();
      own = new AbortController();
      context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
      drawn = lines.length === 0 ? null : chart({
        label, x: "simulations", signal: own.signal, height: 260, options,
        series: lines.map((line, index) => ({
          label: line.name, colour: line.colour, dash: DASHES[index % DASHES.length], more: { paths: uPlot.paths.stepped({ align: 1 }) },
        })),
      });
      replace(place, drawn);
    }
    drawn?.update(joined(lines));
  };
  return place;
}

/** Return a column of all x values, then one column for each line: its last value by then, and null after its end. */
function joined(lines) {
  const all = [...new Set(lines.flatMap((line) => line.points.map(([x]) => x)))].sort((a, b) => a - b);
  return [all, ...lines.map(({ points }) => {
    const end = points.at(-1)?.[0] ?? -1;
    let next = 0;
    let last = null;
    return all.map((x) => {
      while (next < points.length && points[next][0] <= x) last = points[next++][1];
      return x <= end ? last : null;
    });
  })];
}

/**
 * Follow a campaign: its document, its progress and, once it has ended, its scores.
 *
 * @param {string} id
 * @param {object} context Of the view.
 * @param {() => void} changed Called whenever one of them changes.
 * @returns {object} ``id``, and once they are known ``campaign``, ``progress``, ``generations``, ``findings``, ``scores``, ``scoring`` (words), ``trouble``;
 *   ``leave()`` stops following.
 */
function follow(id, context, changed) {
  const own = new AbortController();
  context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
  const followed = { id, campaign: null, progress: null, generations: [], scores: null, scoring: "", findings: null, trouble: "", leave: () => own.abort() };
  const path = `campaigns/${encodeURIComponent(id)}`;
  const retrying = { ...context.retrying, signal: own.signal };

  function refuse(error) {
    if (own.signal.aborted) return;
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) return void context.signIn();
    followed.trouble = error.message;
    changed();
  }

  function take(read) {
    followed.progress = read;
    const [first] = read.generations;
    const known = first === undefined ? followed.generations : followed.generations.filter((one) => one.number < first.number);
    followed.generations = [...known, ...read.generations];
    if (!isOpen(read.status) && !followed.scores && !followed.scoring && searchesBoundary(followed)) score();
    find(`${read.sequence} ${read.reported} ${read.status}`);
    changed();
  }

  const find = loadOnNews(async () => {
    followed.findings = await get(`${path}/findings`, retrying);
    changed();
  }, { signal: own.signal, refuse, leastMs: 5_000 });

  async function score() {
    followed.scoring = "being scored";
    try {
      Object.assign(followed, { scores: await whenMade(`${path}/scores`, { ...retrying, firstS: 3, waitS: 3 }), scoring: "" });
    } catch (error) {
      if (!own.signal.aborted) followed.scoring = "scores are not available";
      refuse(error);
      return;
    }
    changed();
  }

  withRetries(() => get(path, retrying), retrying).then((campaign) => {
    followed.campaign = campaign;
    const since = () => (followed.generations.at(-1)?.number ?? -1) + 1;
    poll(() => `${path}/progress?since=${since()}`, take,
      { ...retrying, busy: (read) => read.status === "running", refuse });
    changed();
  }).catch(refuse);
  return followed;
}

const MOST = 6;
const LISTED = 30;

/**
 * Return the list in which campaigns are chosen.
 *
 * @param {object} context Of the view.
 * @param {() => string[]} chosen Ids of the compared campaigns.
 * @param {(ids: string[]) => void} choose Called with other ids.
 * @returns {HTMLElement} With ``update()``, to be called when the choice changes elsewhere.
 */
function picker(context, chosen, choose) {
  const search = h("input", { type: "search", placeholder: "Name or id", oninput: searched });
  const list = h("ul.picks");
  const said = h("p.hint", { role: "status" });
  const node = h("div.picker", null, h("label", null, "Find ", search), list, said);
  let found = [];
  let more = false;
  let waiting = null;
  context.signal.addEventListener("abort", () => clearTimeout(waiting), { once: true });
  const listing = context.watch(() => `overview?${new URLSearchParams({ limit: LISTED, name: search.value.trim(), follow_ups: "hidden" })}`, (read) => {
    found = rowsOf(read);
    more = read.next !== null;
    node.update();
  });

  function searched() {
    clearTimeout(waiting);
    waiting = setTimeout(listing.now, 250);
  }

  function turn(id, on) {
    choose(on ? [...chosen(), id] : chosen().filter((other) => other !== id));
  }

  node.update = () => {
    const ids = chosen();
    const full = ids.length >= MOST;
    keyed(list, found.map((row) => ({ ...row, on: ids.includes(row.id), full })), (row) => row.id, (row) => pick(row, turn));
    text(said, [
      full ? `${MOST} chosen, which is the maximum: remove one to add another.` : `${count(ids.length)} chosen; at most ${MOST}.`,
      found.length === 0 ? "No campaign matches." : more ? `The latest ${count(found.length)} are listed; find others by name.` : "",
    ].join(" ").trim());
  };
  return node;
}

function pick(first, turn) {
  const box = h("input", { type: "checkbox", onchange: () => turn(first.id, box.checked) });
  const about = h("span.small.muted");
  const node = h("li", null, h("label.check", null, box, h("span", null, first.name, " ", about)));
  node.update = (row) => {
    box.checked = row.on;
    box.disabled = row.full && !row.on;
    attribute(node, "class", row.on ? "on" : null);
    text(about, `${row.id}, ${plainId(row.problem)}, ${plainId(row.algorithm)}, seed ${row.seed}, ${row.status}`);
  };
  node.update(first);
  return node;
}

const LEFT_OUT = new Set(["name"]);

/** Return a row for each setting that differs between campaigns: its path, and its values. */
function differences(campaigns) {
  const flat = campaigns.map((campaign) => Object.fromEntries(flattened(campaign.body)));
  const paths = [...new Set(flat.flatMap((one) => Object.keys(one)))];
  return paths
    .filter((path) => new Set(flat.map((one) => one[path])).size > 1)
    .map((path) => ({ key: path, label: path, cells: flat.map((one) => one[path] ?? "–") }));
}

function* flattened(value, path = []) {
  if (value !== null && typeof value === "object" && !Array.isArray(value)) {
    for (const [name, part] of Object.entries(value)) {
      if (path.length || !LEFT_OUT.has(name)) yield* flattened(part, name === "params" ? path : [...path, name]);
    }
  } else {
    yield [path.join(" "), typeof value === "string" ? value : minus(JSON.stringify(value))];
  }
}
