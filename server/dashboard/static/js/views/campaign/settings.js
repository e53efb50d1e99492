/** What was asked for, and where the algorithm stands, in words. */

import { h } from "../../dom.js";
import { count, figure, plural, spaced } from "../../format.js";

const MOST_LETTERS = 120;

/** Return the card of a campaign's settings, each with what it means as the catalogue says. */
export function settingsCard(body, catalogue) {
  const problem = catalogue.problems.find((one) => one.id === body.problem.id);
  const algorithm = catalogue.algorithms.find((one) => one.id === body.algorithm.id);
  return h("section.card", { "aria-label": "Settings" },
    h("details", null, h("summary", null, h("h2", null, "Settings")),
      h("div.grid-2", null,
        part(`Problem ${body.problem.id}`, problem, body.problem.params),
        part(`Algorithm ${body.algorithm.id}`, algorithm, body.algorithm.params)),
      part("Campaign", null, {
        simulations: body.budget.simulations, seed: body.seed, priority: body.priority, repeats: body.repeats, ...body.execution,
        ...(body.llm ? { language_model: body.llm } : {}),
      })));
}

function part(title, plugin, params) {
  return h("div", null, h("h3", null, title), plugin && h("p.small.muted", null, plugin.summary),
    h("table", null, h("caption.read-out", null, title), h("tbody", null, Object.entries(params).map(([name, value]) => {
      const described = plugin?.params?.properties?.[name];
      const written = typeof value === "string" ? value : JSON.stringify(value);
      return h("tr", null, h("th", { scope: "row", title: described?.description ?? null }, spaced(name)),
        h("td.mono", null, written.length > MOST_LETTERS ? `${written.slice(0, MOST_LETTERS)}…` : written, described?.unit ? ` ${described.unit}` : ""));
    }))));
}

/** Return where the search stands, in sentences. */
export function inWords(progress, generations, algorithm) {
  const told = [];
  const last = generations.list.at(-1);
  told.push(`${algorithm?.summary ?? "The search"} ${plural(progress.generation, "generation")} told.`.replace(/\.\. /, ". "));
  if (progress.status === "running" && progress.asking) told.push(`A language model is being asked: ${progress.asking}.`);
  else if (progress.status === "running") {
    told.push(`Generation ${progress.generation + 1} is being simulated: ${plural(progress.leased, "job")} at workers, ${count(progress.queued)} waiting.`);
  } else if (progress.status === "paused") told.push("It is paused: no job is handed out.");
  if (last?.best_fitness !== null && last?.best_fitness !== undefined) {
    told.push(`Fitness of the last generation: best ${figure(last.best_fitness)}, median ${figure(last.median_fitness)}; its step took ${figure(last.step_s, 2)} s.`);
  }
  const origins = Object.entries(progress.origins);
  if (origins.length) told.push(`Solutions come from: ${origins.map(([name, number]) => `${spaced(name)} ${count(number)}`).join(", ")}.`);
  if (progress.digest) told.push(`SHA-256 of the archive: ${progress.digest.slice(0, 16)}….`);
  return told.join(" ");
}
