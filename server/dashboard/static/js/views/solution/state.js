/** What the map does not say in words: speed, plan, traffic light and robustness at the time that is shown. */

import { attribute, h, text } from "../../dom.js";
import { minus, plainId, spaced } from "../../format.js";
import { facts } from "../../parts/elements.js";
import { seconds } from "./controls.js";

const MOST_EVENTS = 300;

/** Return the state of a player's episode. */
export function state(player) {
  const { told, story } = player.episode;
  const node = facts();
  node.classList.add("replay-state");
  const light = told.lights.some(Boolean);
  player.listen((_, changed) => {
    if (!changed.sample) return;
    const { sample } = player;
    const target = told.target_speed_mps[sample];
    const fast = told.ego.speed_mps[sample];
    const stands = { Speed: mps(fast), "Target speed": mps(target), Plan: spaced(told.plan_mode[sample] || "–") };
    if (light) stands["Traffic light"] = told.lights[sample] || "none";
    const value = story && told.robustness[story.requirement][sample];
    if (story) stands[spaced(plainId(story.requirement))] = margin(value, told.units[story.requirement]);
    node.update(stands);
    node.classList.toggle("violated", value !== null && value < 0);
  });
  return node;
}

function mps(speed) {
  return speed === null ? "–" : `${minus(speed.toFixed(1))} m/s`;
}

function margin(value, unit) {
  if (value === null) return "not concerned";
  return `${minus(value.toFixed(Math.abs(value) < 10 ? 2 : 1))}${unit ? ` ${unit}` : ""}`;
}

/** Return the events of a player's episode as a list; a click goes to one. */
export function events(player) {
  const { episode, signal } = player;
  const told = episode.told.events.slice(0, MOST_EVENTS);
  const more = episode.told.events.length - told.length;
  if (told.length === 0) return h("div.replay-events", null, h("h3", null, "Events"), h("p.hint", null, "None were recorded."));
  const items = told.map((event) => h("li", { class: event.kind }, h("button.quiet.figure", { type: "button", onclick: () => {
    player.pause();
    player.seek(event.time_s);
  } }, seconds(event.time_s)), h("span", null, words(event))));
  const list = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Events in the order of time" }, h("ol", null, items));
  let current = -1;
  player.listen((_, changed) => {
    if (!changed.sample || signal.aborted) return;
    const now_s = episode.times[player.sample] + 1e-3;
    const at = told.findLastIndex((event) => event.time_s <= now_s);
    if (at === current) return;
    attribute(items[current] ?? list, "aria-current", null);
    current = at;
    if (!items[at]) return;
    attribute(items[at], "aria-current", "time");
    const hidden = items[at].offsetTop < list.scrollTop || items[at].offsetTop + items[at].offsetHeight > list.scrollTop + list.clientHeight;
    if (hidden) list.scrollTop = items[at].offsetTop - list.clientHeight / 2;
  });
  const node = h("div.replay-events", null, h("h3", null, "Events"), list);
  if (more > 0) node.append(text(h("p.hint"), `And ${more} more.`));
  return node;
}

function words({ kind, text: said }) {
  return kind === "action" ? spaced(said).replace(":", ": ") : said;
}
