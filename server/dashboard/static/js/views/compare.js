/** Campaigns side by side: facts, courses, DBS tables beside their controls, what differs in their settings. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { count, figure, percent, plainId } from "../format.js";
import { callout } from "../parts/callout.js";
import { matrix } from "../parts/matrix.js";
import { segments } from "../parts/segments.js";
import { NAMES, thresholds } from "../parts/thresholds.js";
import { link, rewrite } from "../router.js";
import { course } from "./compare/courses.js";
import { follow } from "./compare/follow.js";
import { MOST, picker } from "./compare/picker.js";
import { differences } from "./compare/settings.js";

const HUES = ["--series-1", "--series-2", "--series-3", "--series-4", "--series-5", "--series-6"];
const FITNESS = [["best_fitness", "Best"], ["median_fitness", "Median"]];
const GREEDY = "From t_b 1/9 on, all-safe neighbourhoods count as boundary; strict DBS leaves them out. Both are greedy counts, so that either may be larger by a few.";
const PAPER = { t_bs: [0.01, 0.03, 0.05, 0.1, 0.15, 0.2], d_ths: [0.1, 0.2, 0.3] };

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
    asked.length > MOST && callout("warn", `${count(asked.length)} campaigns were asked for: the first ${MOST} are compared, which is the most that can be told apart.`),
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

  /** Draw soon, once for all that has come by then. */
  function changed() {
    if (due) return;
    due = true;
    setTimeout(() => {
      due = false;
      if (!context.signal.aborted) page.draw(named(ids.map((id) => followed.get(id))), fitness, (id) => choose(ids.filter((other) => other !== id)));
    }, 0);
  }
}

/** Give each campaign its name: with its id, where two are called the same. */
function named(all) {
  const names = all.map((one) => one.campaign?.name);
  return all.map((one, index) => ({
    ...one, name: !one.campaign ? one.id : names.indexOf(names[index]) === names.lastIndexOf(names[index]) ? names[index] : `${names[index]} ${one.id}`,
  }));
}

function pageOf(context, query, changed, chooseFitness) {
  const choice = thresholds(query, changed);
  choice.update(PAPER);
  const chips = h("ul.chips", { "aria-label": "Campaigns that are compared" });
  const few = h("p.empty");
  const notes = h("div");
  const facts = matrix("What campaigns are and what they reached", "Of each", { right: false });
  const dbs = course("DBS over simulations", context, { scales: { x: { time: false }, y: { range: fromNought } } });
  const dbsHeading = h("h2");
  const dbsHint = h("p.hint");
  const fitness = course("Fitness over simulations", context);
  const which = segments("Fitness", chooseFitness, FITNESS, "best_fitness");
  const gridHeading = h("h2");
  const grid = matrix("DBS, and strict DBS in brackets, by t_b", "Campaign", { right: true });
  const gridHint = h("p.hint");
  const says = h("ul.sentences");
  const settings = matrix("Settings that differ", "Setting", { right: false });
  const same = h("p.muted");
  const shown = h("div.stack", null, notes, choice,
    h("div.card", null, h("h2", null, "Side by side"), facts),
    h("div.grid-2", null,
      h("div.card", null, dbsHeading, dbs, dbsHint),
      h("div.card", null, h("div.inline.between", null, h("h2", null, "Fitness"), which), fitness, h("p.hint", null, "Of what each algorithm minimises: the scales of two algorithms need not be the same."))),
    h("div.card", null, gridHeading, grid, says, gridHint),
    h("div.card", null, h("h2", null, "Settings that differ"), settings, same));

  function draw(all, fitnessName, take) {
    keyed(chips, all, (one) => one.id, (one) => chip(one, take));
    shown.hidden = all.length < 2;
    few.hidden = all.length >= 2;
    text(few, all.length === 1 ? "Choose one more campaign to compare it with." : "Choose two campaigns or more.");
    if (shown.hidden) return;
    const chosen = choice.chosen;
    const columns = all.map((one) => ({ key: `${one.id} ${one.name}`, head: () => h("span", null, swatch(one.colour), h("a", { href: link("campaigns", one.id) }, one.name)) }));
    note(notes, all);
    facts.update(columns, factRows(all, chosen));
    text(dbsHeading, chosen.measure === "strict" ? "Strict DBS over simulations" : "DBS over simulations");
    const usual = all.find((one) => one.progress)?.progress;
    text(dbsHint, usual ? `As it stood after each generation, at t_b ${figure(usual.t_b)}, d_th ${figure(usual.d_th)}.` : "");
    const series = chosen.measure === "strict" ? "strict_dbs" : "dbs";
    dbs.update(all.filter(begun).map((one) => lineOf(one, series)));
    which.update(FITNESS, fitnessName);
    fitness.update(all.filter(begun).map((one) => lineOf(one, fitnessName)));
    text(gridHeading, `DBS at d_th ${figure(chosen.d_th)}, strict DBS in brackets`);
    const draws = all.find((one) => one.scores?.control)?.scores.draws;
    text(gridHint, `${draws ? `Controls: verdicts redrawn without regard to behaviour; means of ${draws} draws. ` : ""}${GREEDY}`);
    grid.update([{ key: "unsafe", head: "unsafe within the budget" }, ...PAPER.t_bs.map((t_b) => ({ key: t_b, head: `t_b ${figure(t_b)}` }))], gridRows(all, chosen.j));
    keyed(says, all.filter((one) => one.scores?.says.length), (one) => one.id, (first) => {
      const node = h("li");
      node.update = (one) => text(node, `${one.name}: ${one.scores.says[choice.chosen.i][choice.chosen.j]}.`);
      node.update(first);
      return node;
    });
    const ready = all.filter((one) => one.campaign);
    const rows = differences(ready.map((one) => one.campaign));
    settings.hidden = rows.length === 0;
    settings.update(ready.map((one) => ({ key: `${one.id} ${one.name}`, head: one.name })), rows);
    text(same, rows.length ? "" : "None: they are the same campaign in all but name.");
  }

  return { chips, nodes: [few, shown], draw };
}

function chip(first, take) {
  const name = h("a", { href: link("campaigns", first.id) });
  const away = h("button.quiet", { type: "button", onclick: () => take(first.id) }, "×");
  const node = h("li.chip", null, swatch(first.colour), name, away);
  node.update = (one) => {
    text(name, one.name);
    attribute(away, "aria-label", `Take ${one.name} away`);
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
  const budgets = new Set(all.map((one) => one.progress?.budget).filter(Boolean));
  const others = all.filter((one) => one.progress && !one.progress.looks_for_boundary);
  const words = [
    problems.size > 1 && ["warn", "They search different problems: the figures of one say nothing of those of another."],
    problems.size === 1 && worlds.size > 1 && ["warn", "Their problems are not set the same: what differs may be owed to that."],
    problems.size === 1 && budgets.size > 1 && ["warn", "Their budgets differ: more simulations find more. The charts show what each had found after as many."],
    others.length > 0 && ["", `${others.map((one) => one.name).join(", ")} ${others.length === 1 ? "does" : "do"} not look for the hazard boundary, so that DBS does not say how well ${others.length === 1 ? "it" : "they"} did.`],
    ...all.filter((one) => one.trouble).map((one) => ["bad", `${one.name}: ${one.trouble}`]),
  ].filter(Boolean);
  const told = JSON.stringify(words);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place, words.map(([kind, said]) => callout(kind, said)));
}

function factRows(all, { measure, t_b, d_th, i, j }) {
  const row = (label, say) => ({ key: label, label, cells: all.map((one) => say(one) ?? (one.trouble ? "–" : "…")) });
  const scored = (say, so_far) => (one) => (one.scores ? say(one.scores) : one.progress ? one.scoring || so_far?.(one) || "when it has ended" : null);
  const lately = (name) => ({ progress, generations }) => (progress.t_b === t_b && progress.d_th === d_th && generations.length > 0 ? `${count(generations.at(-1)[name])} so far` : "");
  const control = (say) => scored((scores) => (scores.control ? say(scores.control) : "none"));
  return [
    row("Problem", (one) => one.campaign && plainId(one.campaign.body.problem.id)),
    row("Algorithm", (one) => one.campaign && plainId(one.campaign.body.algorithm.id)),
    row("Seed", (one) => one.campaign && String(one.campaign.body.seed)),
    row("Status", (one) => one.progress?.status),
    row("Simulations", (one) => one.progress && `${count(one.progress.simulations)} of ${count(one.progress.budget)}`),
    row("Unsafe of all", (one) => one.progress && percent(one.progress.evaluated ? one.progress.unsafe / one.progress.evaluated : null)),
    row("DBS", scored((scores) => figure(scores.dbs.at(-1)[i][j]), lately("dbs"))),
    row("Strict DBS", scored((scores) => figure(scores.strict.at(-1)[i][j]), lately("strict_dbs"))),
    row(`Its control's ${NAMES[measure]}`, control((blind) => figure(blind[measure].at(-1)[i][j]))),
    row("Behaviours a scenario", control((blind) => `${blind.behaviours_a_scenario.toFixed(1)}${blind.reads_low ? ", its control reads low" : ""}`)),
  ];
}

function gridRows(all, j) {
  return all.flatMap((one) => {
    const rows = (source, share, extra) => [percent(share), ...source.dbs.at(-1).map((row, i) => `${figure(row[j])} (${figure(source.strict.at(-1)[i][j])})${extra}`)];
    if (!one.scores) return [{ key: `${one.id} ${one.name}`, label: one.name, cells: ["–", ...PAPER.t_bs.map(() => (one.progress || one.trouble ? one.scoring || "–" : "…"))] }];
    const blind = one.scores.control;
    return [
      { key: `${one.id} ${one.name} scored`, label: one.name, cells: rows(one.scores, one.scores.unsafe_share, "") },
      ...(blind ? [{ key: `${one.id} ${one.name} control`, class: "muted", label: `${one.name}, control${blind.reads_low ? " (reads low)" : ""}`, cells: rows(blind, blind.unsafe_share, "") }] : []),
    ];
  });
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
