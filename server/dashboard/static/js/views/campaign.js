/** One campaign: status, tolerances, pairs, map, convergence, boundary solutions, parameter dependence, findings, settings. */

import { download, isOpen } from "../api.js";
import { h, replace, text } from "../dom.js";
import { count, percent, plural, rate, span, when } from "../format.js";
import { go, link } from "../router.js";
import { badge, callout, facts, meter, sure, workerCommand } from "../parts/elements.js";
import { steering } from "./campaigns.js";
import { boundaryCard, dependenceCard, findings, inWords, settingsCard } from "./campaign/cards.js";
import { convergenceCards, Generations } from "./campaign/convergence.js";
import { mapCard } from "./campaign/map_card.js";
import { pairsCard } from "./pairs.js";
import { toleranceCard } from "./tolerance.js";

export async function show(main, context, { parts, query }) {
  const [campaign, problems, algorithms] = await Promise.all([
    context.get(`campaigns/${encodeURIComponent(parts[1])}`), context.get("problems"), context.get("algorithms"),
  ]);
  const { id, name, body } = campaign;
  context.title(name);
  const algorithm = algorithms.find((one) => one.id === body.algorithm.id);
  const generations = new Generations();

  const state = badge(campaign.status);
  const actions = h("div.actions.push");
  const notes = h("div");
  const bar = meter("Simulations done");
  const figures = facts();
  const words = h("p.hint", { "aria-live": "polite" });
  const map = mapCard(context, id, query);
  const convergence = convergenceCards(context, id, query, campaign.thresholds);
  const boundary = boundaryCard(context, id, (read) => {
    map.ring(read.solutions.map((one) => one.number));
    convergence.explain(read.note);
  });
  const problem = problems.find((one) => one.id === body.problem.id);
  const found = findings(context, id, problem?.finds ?? []);
  const tolerance = toleranceCard(context, id);
  const pairs = pairsCard(context, id);
  const dependence = dependenceCard(context, id, map.parameters);

  replace(main,
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns")),
    h("div.head", null, h("h1", null, name), state, actions),
    notes,
    h("div.stack", null,
      h("section.card", { "aria-label": "Progress" }, bar, figures, words),
      tolerance, pairs, map,
      h("div.grid-wide", null, convergence.dbs, h("div.stack", null, convergence.shares, convergence.fitness)),
      boundary, found, dependence,
      settingsCard(body, { problems, algorithms }),
      h("p.hint", null, `Campaign ${id}, submitted ${when(campaign.created_at)}. `,
        h("button.quiet", { type: "button", onclick: () => context.tell(() => download(`campaigns/${id}/archive.npz`, `archive-${id}.npz`)) }, "All solutions (npz)"))));

  const polling = context.watch(() => `campaigns/${id}/progress?since=${generations.next}`, take, {
    busy: (read) => read.status === "running",
  });
  // The table of boundary solutions follows the thresholds of the curve.
  context.thresholds = () => boundary.news(generations.next, convergence.thresholds(), { atOnce: true });
  let steered = "";

  function take(read) {
    generations.take(read.generations);
    const ended = !isOpen(read.status);
    state.update(read.status);
    bar.update(read.simulations / read.budget, ended);
    const last = generations.list.at(-1);
    figures.update({
      Simulations: `${count(read.simulations)} of ${count(read.budget)}`,
      Unsafe: read.evaluated ? `${count(read.unsafe)} (${percent(read.unsafe / read.evaluated)})` : "–",
      ...(read.looks_for_boundary && last ? { "DBS (strict)": `${count(last.dbs)} (${count(last.strict_dbs)})` } : {}),
      Generations: count(read.generation),
      ...(ended ? { Took: span(read.elapsed_s) } : { Rate: rate(read.rate_per_s), "Time left": span(read.remaining_s), Running: span(read.elapsed_s), Workers: count(read.workers) }),
      ...(read.failed ? { Failed: count(read.failed) } : {}),
      ...(read.measured ? { Measured: count(read.measured) } : {}),
      ...(read.quarantined ? { "In quarantine": count(read.quarantined) } : {}),
    });
    text(words, inWords(read, generations, algorithm));
    warn(read);
    if (steered !== read.status) {
      steered = read.status;
      const inside = actions.contains(document.activeElement);
      replace(actions, h("a.quiet", { href: link("compare", { ids: id }) }, "Compare"),
        context.may.steer && steering({ ...read, id, name }, context, polling, { clonable: !algorithm?.internal }), context.may.remove && ended && remover());
      if (inside) actions.querySelector("button")?.focus();
    }
    map.news(read.generation);
    convergence.news(read, generations);
    convergence.fitness.hidden = read.looks_for_tolerances; // it minimises nothing
    if (read.looks_for_boundary) boundary.news(read.generation, convergence.thresholds());
    found.news(`${read.sequence}`);
    if (read.looks_for_tolerances && read.evaluated) tolerance.news(`${read.generation} ${ended}`);
    pairs.news(`${read.generation} ${ended}`);
    dependence.news(read.generation);
  }

  function warn(read) {
    const told = JSON.stringify([read.trouble, read.status, read.status_reason, read.workers === 0, read.unrunnable, read.quarantined]);
    if (notes.dataset.told === told) return; // keeps selection and focus
    notes.dataset.told = told;
    replace(notes, warnings(read));
  }

  function warnings(read) {
    const unrunnable = Object.entries(read.unrunnable);
    return [
      read.trouble && callout("bad", `The database currently rejects writes: ${read.trouble}. No acknowledged result is lost.`),
      read.status_reason && callout(read.status === "failed" ? "bad" : "warn", read.status_reason),
      read.status === "running" && read.workers === 0 && callout("warn", "No worker is running. Start one: ", workerCommand()),
      read.status === "running" && read.workers > 0 && unrunnable.map(([needs, jobs]) => callout("warn", `${plural(jobs, "job")} cannot run on any live worker: ${jobs === 1 ? "it needs" : "they need"} ${needs}.`)),
      read.quarantined > 0 && callout("warn", `${plural(read.quarantined, "job")} in quarantine. `, h("a", { href: link("jobs", { status: "quarantined", campaign: id }) }, "Inspect and retry")),
    ];
  }

  function remover() {
    return h("button.danger", { type: "button", onclick: async () => {
      if (!await sure(`Delete ${name} and all of its results? This cannot be undone.`, { yes: "Delete" })) return;
      if (await context.act("DELETE", `campaigns/${id}`, `${name} has been deleted.`) !== undefined) go("campaigns");
    } }, "Delete");
  }
}
