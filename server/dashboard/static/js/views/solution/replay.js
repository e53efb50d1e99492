/** The replay of an episode: map, camera, state and events, played together; charts over time below it. */

import { h } from "../../dom.js";
import { plainId, spaced } from "../../format.js";
import { boxes } from "./boxes.js";
import { camera } from "./camera.js";
import { controls } from "./controls.js";
import { map } from "./map.js";
import { Player } from "./player.js";
import { robustness } from "./robustness.js";
import { events, state } from "./state.js";
import { Episode } from "./episode.js";

/**
 * Return the cards of an episode, and its player.
 *
 * @param {import("../../context.js").Context} context
 * @param {object} told The episode as it came.
 * @param {object} solution
 * @param {string} path Of the solution.
 * @param {Element} actions What can be done with it.
 */
export function replay(context, told, solution, path, actions) {
  const episode = new Episode(told);
  const player = new Player(episode, context.signal);
  const { node, keys, toggles } = map(player);
  const stage = h("section.card.replay", { "aria-label": "Replay" },
    h("div.inline", null, h("h2", null, "Replay"), actions),
    told.words.scenario && h("p.hint", null, [told.words.scenario, told.words.perturbations].filter(Boolean).join("; the camera's pictures: ")));
  stage.append(h(episode.film ? "div.replay-stage.film" : "div.replay-stage", null,
    h("div", null, node, h("div.replay-under", null, keys, toggles)),
    h("div.replay-side", null, camera(player, path), state(player), events(player))),
  controls(player, marks(episode, solution), stage));
  return { player, cards: [stage, boxes(player), robustness(player)].filter(Boolean) };
}

/** Return what is marked on the scrubber: violations as they were judged, and events. */
function marks(episode, solution) {
  const found = episode.told.events.filter(({ kind }) => kind !== "action").map(({ time_s, text, kind }) => ({ time_s, words: text, bad: kind === "violation" }));
  for (const [name, one] of Object.entries(solution.verdicts ?? {})) {
    if (one.violated_at_s !== null) found.push({ time_s: one.violated_at_s, words: `${spaced(plainId(name))} violated`, bad: true });
  }
  if (!found.some((mark) => mark.bad) && episode.story?.violated) {
    found.push({ time_s: episode.times[episode.story.decisive], words: `${spaced(plainId(episode.story.requirement))} violated`, bad: true });
  }
  return found.sort((a, b) => a.time_s - b.time_s);
}
