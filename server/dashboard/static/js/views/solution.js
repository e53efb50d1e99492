/** One solution: its description, its verdicts, its neighbourhood, and the replay of its episode. */

import { isOpen } from "../api.js";
import { h, replace } from "../dom.js";
import { count, figure, plainId, spaced } from "../format.js";
import { link } from "../router.js";
import { facts, outcomeBadge } from "../parts/elements.js";
import { addToSuite } from "../parts/suite.js";
import { judgedBy, neighbourhood, parameters, repeats, verdicts, withUnit } from "./solution/cards.js";
import { downloads, loading, replay } from "./solution/replay.js";

export async function show(main, context, { parts }) {
  const number = Number(parts[3]);
  const campaign = await context.get(`campaigns/${encodeURIComponent(parts[1])}`);
  const path = `campaigns/${campaign.id}/solutions/${number}`;
  context.title(`Solution ${number}, ${campaign.body.name}`);
  const [solution, following] = await Promise.all([
    context.get(path), context.get(`campaigns/${campaign.id}/solutions?after=${number}&limit=1`),
  ]);
  const judged = judgedBy(solution);
  const evaluated = isEvaluated(solution);
  const running = isOpen(campaign.status);
  // Known before anything is shown, so that nothing moves afterwards.
  const neighbours = evaluated && !running && await context.tell(() => context.get(`${path}/neighbours`));

  const verdict = outcomeBadge(solution);
  const figures = facts();
  figures.classList.add("wide");
  const around = neighbourhood(campaign);
  // A solution without a specification was computed or measured: another seed would change nothing.
  const again = evaluated && solution.spec && repeats(context, campaign, number);
  const place = h("div.stack.replay-place");
  let player = null;

  function goTo(time_s) {
    if (!player) return;
    player.hold(time_s);
    place.scrollIntoView({ block: "start" });
  }

  const table = verdicts(solution, judged, goTo);
  replace(main,
    head({ campaign, solution, judged, verdict, next: following.solutions[0]?.number }),
    h("div.stack", null,
      h("div.grid-2", null,
        h("div.stack", null,
          evaluated && around.opposite,
          h("section.card", { "aria-label": "Description" }, h("h2", null, "Description"), h("p", null, solution.words || "–"),
            solution.failure && h("p.trouble", null, `Failed: ${solution.failure}`), figures),
          evaluated && around.card),
        table ?? h("div")),
      place,
      h("div.grid-2.uneven", null, h("div.stack", null, again, parameters(solution)), evaluated && around.table)));
  update(solution);

  function update(read) {
    if (read.verdict !== solution.verdict) {
      dispatchEvent(new Event("hashchange")); // an evaluated solution has more cards: show the view anew
      return;
    }
    verdict.update(read);
    figures.update({
      ...(campaign.finds.includes("boundary") ? { Fitness: figure(read.fitness) } : {}), Generation: count(read.generation), Origin: read.origin ? spaced(read.origin) : "–",
      Seed: String(read.seed), Attempts: count(read.attempts),
      ...(read.losses ? { "Lost attempts": count(read.losses) } : {}),
    });
  }

  if (running) context.watch(path, update);
  if (neighbours) around.update(neighbours);
  else if (evaluated && running) context.watch(`${path}/neighbours`, around.update, { refuse: () => {} });

  const reason = withoutEpisode(solution);
  if (reason) {
    replace(place, h("section.card", { "aria-label": "Replay" }, h("h2", null, "Replay"), h("p.hint", null, reason)));
    return;
  }
  replace(place, loading(context, path, (data) => {
    const found = replay(context, data, solution, path, downloads(context, path, `${campaign.id}-${number}`, solution.spec));
    player = found.player;
    replace(place, found.cards);
  }));
}

function isEvaluated({ verdict }) {
  return verdict === "safe" || verdict === "unsafe";
}

/** Return the breadcrumb, the heading, and the links to other solutions. */
function head({ campaign, solution, judged, verdict, next }) {
  const { id, body } = campaign;
  const { number, robustness, verdicts: found } = solution;
  return [
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, body.name)),
    h("div.head", null, h("h1", null, `Solution ${number}`), verdict,
      isEvaluated(solution) && h("span.figure", null, `${judged ? `${spaced(plainId(judged))} margin` : "robustness"} ${withUnit(robustness, found?.[judged]?.unit)}`),
      h("nav.actions.push", { "aria-label": "Solutions" },
        number > 0 && h("a.button", { href: link("campaigns", id, "solutions", number - 1) }, "Previous"),
        next !== undefined && h("a.button", { href: link("campaigns", id, "solutions", next) }, "Next"),
        h("a.button", { href: link("campaigns", id, { tab: "map", solution: number }) }, "Open on the map"),
        isEvaluated(solution) && addToSuite(id, `--solutions ${number}`, "this drive"))),
  ];
}

/** Return the reason why a solution has no episode to show; empty if it has one. */
function withoutEpisode({ spec, verdict, verdicts: judged }) {
  if (verdict === "measured") return "This solution was measured on a data set, so there is no episode.";
  if (!spec) return "This solution was computed, not simulated, so there is no episode.";
  return verdict === "pending" && !judged ? "This solution has not been simulated yet." : "";
}
