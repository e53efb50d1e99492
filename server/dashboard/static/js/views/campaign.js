/** One campaign: its finding, best pictures and next steps on one screen; everything else behind tabs. */

import { download, isOpen } from "../api.js";
import { h, replace } from "../dom.js";
import { clause, plural, sentence, when } from "../format.js";
import { go, link } from "../router.js";
import { badge, callout, sure, waitsFor, workerCommand } from "../parts/elements.js";
import { tabs } from "../parts/tabs.js";
import { steering } from "./campaigns.js";
import { aboutCard, dependenceCard, repeatsCard, settingsCard } from "./campaign/cards.js";
import { convergenceCards, Generations } from "./campaign/convergence.js";
import { finding } from "./campaign/finding.js";
import { total } from "../parts/tables.js";
import { kindCards } from "./campaign/kinds.js";
import { labels } from "./campaign/labels.js";
import { mapCard } from "./campaign/map_card.js";

export async function show(main, context, { parts, query }) {
  const [campaign, problems, algorithms] = await Promise.all([
    context.get(`campaigns/${encodeURIComponent(parts[1])}`), context.get("problems"), context.get("algorithms"),
  ]);
  const { id, name, body } = campaign;
  context.title(name);
  const algorithm = algorithms.find((one) => one.id === body.algorithm.id);
  const problem = problems.find((one) => one.id === body.problem.id);
  const generations = new Generations();

  const state = badge(campaign.status);
  const actions = h("div.actions.push");
  const notes = h("div");
  const labelled = labels(context, id, () => polling.now());
  const map = mapCard(context, id, query);
  const convergence = convergenceCards(context, id, query, campaign.thresholds);
  let ringed = null; // the kind whose results have rings on the map
  const kinds = kindCards(context, id, { boundary: convergence.chosen }, (one) => {
    if (one.kind === ringed) map.ring(one.rings, total(one.tables[0]));
  });
  const opening = finding(context, id, (read) => {
    ringed = read.findings.find((one) => one.rings.length)?.kind ?? null;
    kinds.update(read);
    arrange(read);
    open();
  }, () => polling.now());
  const found = repeatsCard(context, id);
  const dependence = dependenceCard(context, id, map.parameters);
  const about = aboutCard(algorithm);
  const removing = h("span");
  const results = h("div.stack", null, kinds, found);
  const pages = tabs("Parts of the campaign", query, {
    overview: ["Overview", opening],
    map: ["Map", map],
    results: ["Results", results],
    parameters: ["Parameters", dependence],
    search: ["Search", h("div.stack", null, convergence.card, about)],
    settings: ["Settings", h("div.stack", null, settingsCard(body, { problems, algorithms }),
      h("p.hint", null, `Campaign ${id}, submitted ${when(campaign.created_at)}. `,
        h("button.quiet", { type: "button", onclick: () => context.tell(() => download(`campaigns/${id}/archive.npz`, `archive-${id}.npz`)) }, "All solutions (npz)"), removing))],
  });
  const page = h("div", { hidden: true }, notes, pages);
  const loading = h("p.loading", { role: "status" }, "Loading …");
  let progress = null;

  replace(main,
    h("div.head.campaign", null, h("h1", null, name), state, labelled, actions),
    loading, page);

  /** Show the page once there is all that decides its layout, so that nothing moves afterwards. */
  function open() {
    if (!progress || !opening.read) return;
    loading.remove();
    page.hidden = false;
  }

  /** Put beside the next steps what tells most: the pictures, else the map, or the results of a search whose map says nothing. */
  function arrange(read) {
    const beside = opening.hasPictures ? null : read.exclusive ? results : map;
    for (const [part, node] of Object.entries({ map, results })) {
      const to = node === beside ? opening.place : pages.panels[part];
      if (node.parentElement !== to) to.append(node);
    }
    pages.settle();
  }

  const polling = context.watch(() => `campaigns/${id}/progress?since=${generations.next}`, take, {
    busy: (read) => read.status === "running",
  });
  context.thresholds = kinds.refresh; // the table of boundary solutions follows the thresholds of the curve
  let steered = "";

  function take(read) {
    progress = read;
    generations.take(read.generations);
    const ended = !isOpen(read.status);
    state.update(read.status);
    labelled.update(read);
    warn(read);
    if (steered !== read.status) {
      steered = read.status;
      const inside = actions.contains(document.activeElement);
      replace(actions, h("a.quiet", { href: link("compare", { ids: id }) }, "Compare"),
        context.may.steer && steering({ ...read, id, name }, context, polling, { clonable: !algorithm?.internal }));
      if (inside) actions.querySelector("button")?.focus();
      replace(removing, context.may.remove && ended && remover());
    }
    opening.news(read);
    map.news(`${read.generation} ${read.simulations}`, { boundary: read?.finds[0] === "boundary" });
    convergence.news(read, generations);
    found.news(`${read.sequence}`);
    if (read.evaluated) dependence.news(read.generation);
    about.update(read, generations);
    open();
  }

  function warn(read) {
    const told = JSON.stringify([read.trouble, read.status, read.status_reason, read.workers === 0, read.unrunnable, read.quarantined]);
    if (notes.dataset.told === told) return; // keeps selection and focus
    notes.dataset.told = told;
    replace(notes, warnings(read));
  }

  function warnings(read) {
    const waits = waitsFor(read);
    return [
      read.trouble && callout("bad", `The database currently rejects writes: ${clause(read.trouble)}. No acknowledged result is lost.`),
      read.status_reason && callout(read.status === "failed" ? "bad" : "warn", read.status_reason),
      read.status === "running" && read.workers === 0 && callout("warn", "No worker is running. ", waits, "Start one: ", workerCommand()),
      read.status === "running" && read.workers > 0 && waits && callout("warn", "No live worker can run all jobs: ", waits),
      read.quarantined > 0 && callout("warn", `${plural(read.quarantined, "job")} in quarantine. `, h("a", { href: link("jobs", { status: "quarantined", campaign: id }) }, "Inspect and retry"), read.failure && ` First error: ${sentence(read.failure)}`),
    ];
  }

  function remover() {
    return h("button.quiet", { type: "button", onclick: async () => {
      const doomed = await context.tell(() => context.get(`campaigns/${id}/deletion`));
      if (doomed === undefined) return;
      const followUps = doomed.campaigns.length - 1;
      const what = followUps ? `${name} with its ${plural(followUps, "follow-up")}` : name;
      if (!await sure(`Delete ${what} and all results? This cannot be undone.`, { yes: "Delete" })) return;
      if (await context.act("DELETE", `campaigns/${id}`, `${name} has been deleted.`) !== undefined) go("campaigns");
    } }, "Delete");
  }
}
