/** Two drives from above, side by side on one clock. */

import { h } from "../../dom.js";
import { badge } from "../../parts/elements.js";
import { controls, state } from "./controls.js";
import { map } from "./map.js";

/**
 * Fill a card with two drives; return the player whose time is shown and set, which is that of the longer drive.
 *
 * @param {Element} stage The card.
 * @param {{player: import("./episode.js").Player, badge: string[], words: string, colour: string}[]} drives In the order in which
 *   they are shown: player, badge, what the car is called, name of its colour.
 * @param {{time_s: number, words: string, bad?: boolean}[]} marks Of the scrubber.
 */
export function twoDrives(stage, drives, marks) {
  const players = drives.map(({ player }) => player);
  const [first, second] = players;
  const lead = first.episode.end_s >= second.episode.end_s ? first : second;
  const maps = drives.map(({ player }, index) => {
    const { player: { episode: twin }, words, colour } = drives[1 - index];
    return map(player, { twin, words, colour, own: drives[index].colour, ownWords: drives[index].words });
  });
  stage.append(
    h("div.grid-2.both", null, drives.map((drive, index) => h("div.drive", null,
      h("div.inline", null, badge(...drive.badge), ended(drive.player, lead)), maps[index].node, state(drive.player)))),
    controls(lead, marks, stage), maps[0].legend);
  follow(lead, lead === first ? second : first);
  return lead;
}

/** Keep two players at the same time, whichever of them is moved. */
function follow(lead, other) {
  let following = false;
  const move = (from, to) => from.listen((_, changed) => {
    if (!changed.time || following) return;
    following = true;
    to.seek(from.time_s);
    following = false;
  });
  move(lead, other);
  move(other, lead);
}

/** Return a note that shows once a drive has ended while the other one goes on. */
function ended(player, lead) {
  const node = h("span.small.muted", { hidden: true }, player.episode.words.ended);
  lead.listen((_, changed) => {
    if (changed.time) node.hidden = lead.time_s <= player.episode.end_s + 1e-6;
  });
  return node;
}
