/** One pair: the change in words, both drives from above on one clock, and what was reported in each over time. */

import { isOpen } from "../api.js";
import { h, replace } from "../dom.js";
import { capital } from "../format.js";
import { link } from "../router.js";
import { badge, requirementBadge } from "../parts/elements.js";
import { addToSuite } from "../parts/suite.js";
import { askedFor, pairLink, pairsPath } from "./pairs.js";
import { differingSpans, overTime } from "./pair/chart.js";
import { differences, said } from "./pair/words.js";
import { camera } from "./solution/camera.js";
import { Episode, Player, seconds } from "./solution/episode.js";
import { loading } from "./solution/replay.js";
import { twoDrives } from "./solution/two_drives.js";

const SIDES = ["safe", "unsafe"];

export async function show(main, context, { parts, query }) {
  const asked = askedFor(query);
  const numbers = parts[3].split("-").map(Number);
  const campaign = await context.get(`campaigns/${encodeURIComponent(parts[1])}`);
  const { id } = campaign;
  const read = await context.get(pairsPath(id, asked));
  const at = read.pairs.findIndex((one) => one.safe.number === numbers[0] && one.unsafe.number === numbers[1]);
  const crumb = h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, campaign.name),
    " / ", h("a", { href: link("campaigns", id, "pairs", asked) }, "Pairs"));
  if (at < 0) {
    context.title(`Pair, ${campaign.name}`);
    replace(main, crumb, gone(id, numbers));
    return;
  }
  const pair = read.pairs[at];
  context.title(`Pair ${pair.place}, ${campaign.name}`);
  const place = h("div.stack.replay-place");
  const known = h("span");
  const change = h("section.card.the-change", { "aria-label": "The change" });
  const sides = h("div.grid-2");
  replace(main, crumb,
    h("div.head", null, h("h1", null, `Pair ${pair.place}`), known,
      h("nav.actions.push", { "aria-label": "Pairs" },
        at > 0 && h("a.button", { href: pairLink(id, read.pairs[at - 1], asked) }, "Previous"),
        at + 1 < read.pairs.length && h("a.button", { href: pairLink(id, read.pairs[at + 1], asked) }, "Next"),
        addToSuite(id, `--pairs ${parts[3]}`, "both drives of the pair"))),
    h("div.stack", null,
      change, sides, place,
      h("section.card", { "aria-label": "Differences" }, h("h2", null, "Differences"), differences(pair))));
  tell(pair);
  let told = JSON.stringify(pair);
  context.watch(pairsPath(id, asked), (next) => {
    const found = next.pairs.find((one) => one.safe.number === numbers[0] && one.unsafe.number === numbers[1]);
    if (!found || JSON.stringify(found) === told) return;
    told = JSON.stringify(found);
    tell(found);
  }, { busy: (next) => next.follow_ups.some(({ status }) => isOpen(status)), refuse: () => {} });

  /** Show the evidence for the pair, which follow-ups extend. */
  function tell(now) {
    replace(known, now.evidence.map((words) => [badge(words.split(" ")[0], words), " "]));
    replace(change, h("h2", null, "The change"), h("p.lead", null, said(now.change)),
      h("p", null, h("strong", null, "What it does: "), `${now.unsafe.outcome}; without it: ${now.safe.outcome}.`),
      now.shown.map((words) => h("p", null, words)),
      h("p", null, now.facts.join(" "), now.same_seed && !read.computed && " Both drives have the same episode seed: without the change they would be identical."),
      h("p.hint", null, followed(now).map(([solution, words]) => [h("a", { href: link("campaigns", solution.campaign, "solutions", solution.number) }, words), " · "]),
        h("a", { href: link("campaigns", id, "pairs", asked) }, "Ask more about the pairs")));
    replace(sides, SIDES.map((name) => sideCard(id, name, now, read)));
  }

  if (!read.replayable) return;
  const paths = SIDES.map((name) => `campaigns/${id}/solutions/${pair[name].number}`);
  replace(place, loading(context, paths, (...episodes) => replace(place, both(context, episodes, paths))));
}

function gone(id, numbers) {
  return h("div.empty", null, h("h1", null, "No such pair"),
    h("p", null, "These two solutions are not among the distinct pairs of the campaign. While a campaign runs, a nearer pair can take the place of another one."),
    h("p", null, h("a", { href: link("campaigns", id, "pairs") }, "All pairs"), numbers.filter(Number.isInteger).map((number) => [" · ", h("a", { href: link("campaigns", id, "solutions", number) }, `Solution ${number}`)])));
}

/** Return the drives that follow-ups simulated, with words for links. */
function followed({ component, minimality }) {
  return [
    component.outcome && [component, "Drive with ground truth"],
    minimality.unsafe && [{ campaign: minimality.campaign, number: minimality.unsafe.number }, "Drive with the smaller change"],
  ].filter(Boolean);
}

/** Return the card of one side: what happened, how often it is unsafe, and a link to its own page. */
function sideCard(id, name, pair, { computed, replayable }) {
  const side = pair[name];
  return h("section.card", { class: `side ${name}`, "aria-label": `The ${name} side` },
    h("div.headed", null, requirementBadge(side), h("h2", null, capital(side.outcome))),
    h("p", null, side.words),
    h("p.hint", null, !computed && said(side.again || "not simulated again with other seeds"), " ",
      h("a", { href: link("campaigns", id, "solutions", side.number) }, `Solution ${side.number}${replayable ? " with its replay" : ""}`)));
}

/** Return the cards of both drives: maps and cameras side by side, one clock for both, and the chart over time. */
function both(context, data, paths) {
  const players = data.map((one) => new Player(new Episode(one), context.signal));
  const episodes = players.map(({ episode }) => episode);
  const stage = h("section.card.replay", { "aria-label": "Both drives" }, h("h2", null, "Both drives"));
  const drives = SIDES.map((side, index) => ({ player: players[index], badge: [side, `${side} drive`], words: `${side} drive`, colour: `--${side}` }));
  const violations = marks(episodes[1]);
  const lead = twoDrives(stage, drives, violations);
  stage.append(h("p.hint", null, "Outlines show where the car of the other drive is at the same time."));
  if (violations.length) lead.hold(violations[0].time_s);
  const differing = differingSpans(...episodes);
  const first = differing[0] && h("button", { type: "button", onclick: () => lead.hold(differing[0].start_s) }, `Go to ${seconds(differing[0].start_s)}: reports first differ`);
  return [stage, overTime(lead, episodes, differing),
    h("section.card", { "aria-label": "Cameras" }, h("div.inline", null, h("h2", null, "What the detector reported"), first),
      h("div.grid-2", null, players.map((player, index) => h("div", null, badge(SIDES[index], `${SIDES[index]} drive`), camera(player, paths[index])))))];
}

/** Return the marks of the scrubber: the violation that makes the unsafe drive unsafe. */
function marks(episode) {
  const { story } = episode;
  return story?.violated ? [{ time_s: story.violations[0].time_s, words: "the unsafe drive's violation", bad: true }] : [];
}
