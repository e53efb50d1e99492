/** One solution: what it is, how it was judged, its neighbourhood, and its episode to look at. */

import { isOpen } from "../api.js";
import { h, replace, text } from "../dom.js";
import { count, figure, plainId, spaced } from "../format.js";
import { link } from "../router.js";
import { badge, facts } from "../parts/elements.js";
import { again } from "./solution/again.js";
import { downloads } from "./solution/downloads.js";
import { made } from "./solution/made.js";
import { neighbourhood } from "./solution/neighbourhood.js";
import { parameters } from "./solution/parameters.js";
import { replay } from "./solution/replay.js";
import { judgedBy, verdicts, withUnit } from "./solution/verdicts.js";

export async function show(main, context, { parts }) {
  const number = Number(parts[3]);
  const campaign = await context.get(`campaigns/${encodeURIComponent(parts[1])}`);
  const path = `campaigns/${campaign.id}/solutions/${number}`;
  context.title(`Solution ${number}, ${campaign.body.name}`);
  const [solution, following] = await Promise.all([
    context.get(path), context.get(`campaigns/${campaign.id}/solutions?after=${number}&limit=1`),
  ]);
  const judged = judgedBy(solution, campaign);
  const evaluated = isEvaluated(solution);

  const verdict = badge(solution.verdict);
  const figures = facts();
  figures.classList.add("wide");
  const around = neighbourhood(campaign);
  // What was computed or measured says the same with any seed: there is nothing to simulate again.
  const rerun = evaluated && solution.spec && again(context, campaign, number);
  const shown = h("div.stack.replay-place");
  let player = null;

  function goTo(time_s) {
    if (!player) return;
    player.pause();
    player.seek(time_s);
    shown.scrollIntoView({ block: "start" });
  }

  const table = verdicts(solution, judged, goTo);
  replace(main,
    head({ campaign, solution, judged, verdict, next: following.solutions[0]?.number }),
    h("div.stack", null,
      h("div.grid-2", null,
        h("div.stack", null,
          h("section.card", { "aria-label": "What it is" }, h("h2", null, "What it is"), h("p", null, solution.words || "–"),
            solution.failure && h("p.trouble", null, `It failed: ${solution.failure}`), figures),
          evaluated && around.card),
        table ?? h("div")),
      shown,
      h("div.grid-2.uneven", null, h("div.stack", null, rerun, parameters(solution.parameters)), evaluated && around.table)));
  fill(solution);

  function fill(read) {
    if (read.verdict !== solution.verdict) {
      dispatchEvent(new Event("hashchange")); // there is more to show now than there is room for here
      return;
    }
    verdict.update(read.verdict);
    figures.update({
      Fitness: figure(read.fitness), Generation: count(read.generation), Origin: read.origin ? spaced(read.origin) : "–",
      Seed: String(read.seed), Attempts: count(read.attempts),
    });
  }

  const news = isOpen(campaign.status) ? context.watch(path, fill) : null;
  if (evaluated) look();

  async function look() {
    const take = around.update;
    if (news === null) await context.tell(async () => take(await context.get(`${path}/neighbours`)));
    else context.watch(`${path}/neighbours`, take, { refuse: () => {} });
  }

  const absent = withoutEpisode(solution);
  if (absent) {
    replace(shown, h("section.card", { "aria-label": "Replay" }, h("h2", null, "Replay"), h("p.hint", null, absent)));
    return;
  }
  replace(shown, made(context, path, (told) => {
    const found = replay(context, told, solution, path, downloads(context, path, `${campaign.id}-${number}`, solution.spec));
    player = found.player;
    replace(shown, found.cards);
  }));
}

function isEvaluated({ verdict }) {
  return verdict === "safe" || verdict === "unsafe";
}

/** Return the way here, the heading, and the ways on. */
function head({ campaign, solution, judged, verdict, next }) {
  const { id, body } = campaign;
  const { number, robustness, verdicts: told } = solution;
  return [
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, body.name)),
    h("div.head", null, h("h1", null, `Solution ${number}`), verdict,
      isEvaluated(solution) && h("span.figure", null, `${judged ? spaced(plainId(judged)) : "robustness"} ${withUnit(robustness, told?.[judged]?.unit)}`),
      h("nav.actions.push", { "aria-label": "Solutions" },
        number > 0 && h("a.button", { href: link("campaigns", id, "solutions", number - 1) }, "Previous"),
        next !== undefined && h("a.button", { href: link("campaigns", id, "solutions", next) }, "Next"),
        h("a.button", { href: link("campaigns", id, { solution: number }) }, "Open on the map"))),
  ];
}

/** Return why a solution has no episode to look at; empty if it has one. */
function withoutEpisode({ spec, verdict, verdicts: judged }) {
  if (verdict === "measured") return "This solution was measured on a data set: there is no episode.";
  if (!spec) return "This solution was computed, not simulated: there is no episode.";
  return verdict === "pending" && !judged ? "This solution is not simulated yet." : "";
}
