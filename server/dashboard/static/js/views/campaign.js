/** One campaign: where it stands, its map, its course, its boundary, what the verdict depends on. */

import { download } from "../api.js";
import { h, replace, text } from "../dom.js";
import { count, percent, plural, rate, span, when } from "../format.js";
import { badge } from "../parts/badge.js";
import { callout, workerCommand } from "../parts/callout.js";
import { sure } from "../parts/confirm.js";
import { facts } from "../parts/facts.js";
import { meter } from "../parts/meter.js";
import { go, link } from "../router.js";
import { boundaryCard } from "./campaign/boundary.js";
import { courseCards, Generations } from "./campaign/course.js";
import { dependenceCard } from "./campaign/dependence.js";
import { findings } from "./campaign/findings.js";
import { mapCard } from "./campaign/map_card.js";
import { inWords, settingsCard } from "./campaign/settings.js";
import { steering } from "./campaigns.js";

const REPEAT = "repeat@1";

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
  const course = courseCards(context, id, query);
  const boundary = boundaryCard(context, id, map.ring);
  const problem = problems.find((one) => one.id === body.problem.id);
  const found = findings(context, id, problem?.finds ?? []);
  const dependence = dependenceCard(context, id, map.parameters);

  replace(main,
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns")),
    h("div.head", null, h("h1", null, name), state, actions),
    notes,
    h("div.stack", null,
      h("section.card", { "aria-label": "Progress" }, bar, figures, words),
      map,
      h("div.grid-wide", null, course.dbs, h("div.stack", null, course.shares, course.fitness)),
      boundary, found, dependence,
      settingsCard(body, { problems, algorithms }),
      h("p.hint", null, `Campaign ${id}, submitted ${when(campaign.created_at)}. `,
        h("button.quiet", { type: "button", onclick: () => context.tell(() => download(`campaigns/${id}/archive.npz`, `archive-${id}.npz`)) }, "All solutions for numpy"))));

  const polling = context.watch(() => `campaigns/${id}/progress?since=${generations.next}`, take, {
    busy: (read) => read.status === "running",
  });
  // Other thresholds: the table of boundary solutions follows the curve.
  context.thresholds = () => boundary.news(generations.next, course.thresholds(), { atOnce: true });
  let steered = "";

  function take(read) {
    generations.take(read.generations);
    const ended = read.status !== "running" && read.status !== "paused";
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
        context.may.steer && steering({ ...read, id, name }, context, polling, { clonable: body.algorithm.id !== REPEAT }), context.may.remove && ended && remover());
      if (inside) actions.querySelector("button")?.focus();
    }
    map.news(read.generation);
    course.news(read, generations);
    if (read.looks_for_boundary) boundary.news(read.generation, course.thresholds());
    found.news(`${read.sequence}`);
    dependence.news(read.generation);
  }

  function warn(read) {
    const told = JSON.stringify([read.trouble, read.status, read.status_reason, read.workers === 0, read.unrunnable, read.quarantined]);
    if (notes.dataset.told === told) return; // what is selected or focused stays
    notes.dataset.told = told;
    replace(notes, warnings(read));
  }

  function warnings(read) {
    const unrunnable = Object.entries(read.unrunnable);
    return [
      read.trouble && callout("bad", `The database takes no writes now: ${read.trouble}. Nothing that was acknowledged is lost.`),
      read.status_reason && callout(read.status === "failed" ? "bad" : "warn", read.status_reason),
      read.status === "running" && read.workers === 0 && callout("warn", "No worker is there. Start one: ", workerCommand()),
      read.status === "running" && read.workers > 0 && unrunnable.map(([needs, jobs]) => callout("warn", `${plural(jobs, "job")} can be run by no live worker: ${jobs === 1 ? "it needs" : "they need"} ${needs}.`)),
      read.quarantined > 0 && callout("warn", `${plural(read.quarantined, "job")} in quarantine. `, h("a", { href: link("jobs", { status: "quarantined", campaign: id }) }, "Look and retry")),
    ];
  }

  function remover() {
    return h("button.danger", { type: "button", onclick: async () => {
      if (!await sure(`Delete ${name} with all that it found? This cannot be undone.`, { yes: "Delete it" })) return;
      if (await context.act("DELETE", `campaigns/${id}`, `${name} is deleted.`) !== undefined) go("campaigns");
    } }, "Delete");
  }
}
