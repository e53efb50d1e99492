/** The controls of a player, and its state in words. */

import { attribute, h, text } from "../../dom.js";
import { minus, plainId, spaced } from "../../format.js";
import { facts, segments } from "../../parts/elements.js";
import { guardSpans, seconds, tenths } from "./episode.js";

const SPEEDS = [["0.5", "0.5×"], ["1", "1×"], ["2", "2×"], ["4", "4×"]];
const TAKES_SPACE = "input:not([type=range]), textarea, select, button, a, summary, [role=region]";

/**
 * Return the controls of a player: play and pause, scrubber with marks, speed, and a jump to the first violation.
 *
 * @param {Player} player
 * @param {{time_s: number, words: string, bad?: boolean}[]} marks
 * @param {Element} stage While it is in sight, Space plays and pauses unless the focused element uses Space itself.
 */
export function controls(player, marks, stage) {
  const { episode, signal } = player;
  const button = h("button.primary.play", { type: "button", onclick: () => player.toggle() }, "Play");
  const scrubber = h("input", {
    type: "range", min: 0, max: episode.last, step: 1, value: 0, "aria-label": "Time in the episode",
    oninput: () => player.show(Number(scrubber.value)),
  });
  const percent = (sample) => `${(100 * sample) / Math.max(1, episode.last)}%`;
  const track = h("div.marks", { "aria-hidden": "true" }, guardSpans(episode).map(({ state, first, last }) => {
    const span = h(`i.guard.${state}`, { title: `${seconds(episode.times[first])}–${seconds(episode.times[last])}: ${state}` });
    span.style.left = percent(first);
    span.style.width = percent(last - first);
    return span;
  }), marks.map(({ time_s, words, bad }) => {
    const mark = h(bad ? "i.bad" : "i", { title: `${seconds(time_s)}: ${words}` });
    mark.style.left = percent(episode.sampleAt(time_s));
    return mark;
  }));
  const clock = h("output.clock.figure");
  const speeds = segments("Speed", (speed) => player.setSpeed(Number(speed)), SPEEDS, "1");
  const violation = marks.find((mark) => mark.bad);
  const jump = violation && h("button", { type: "button", onclick: () => player.hold(violation.time_s) }, `Go to ${seconds(violation.time_s)}: ${violation.words.replace(/ at [\d.]+ s$/, "")}`);

  player.listen((_, changed) => {
    if (changed.time) text(clock, `${tenths(player.time_s)} / ${seconds(episode.end_s)}`);
    if (changed.sample) {
      if (Number(scrubber.value) !== player.sample) scrubber.value = String(player.sample);
      attribute(scrubber, "aria-valuetext", seconds(episode.times[player.sample]));
    }
    if (changed.state) {
      text(button, player.playing ? "Pause" : "Play");
      speeds.update(SPEEDS, String(player.speed));
    }
  });

  document.addEventListener("keydown", (event) => {
    if (event.key !== " " || event.ctrlKey || event.altKey || event.metaKey || event.defaultPrevented) return;
    if (event.target.closest?.(TAKES_SPACE) || document.querySelector("dialog[open]")) return;
    const { top, bottom } = stage.getBoundingClientRect();
    if (bottom < 0 || top > innerHeight) return;
    event.preventDefault();
    player.toggle();
  }, { signal });

  return h("div.controls", { role: "group", "aria-label": "Playback" },
    button, h("div.scrub", null, track, scrubber), clock, speeds, jump);
}

/** Return the state of a player's episode in words: speed, plan, traffic light, guard and robustness. */
export function state(player) {
  const { data, story } = player.episode;
  const node = facts();
  node.classList.add("replay-state");
  const hasLight = data.lights.some(Boolean);
  player.listen((_, changed) => {
    if (!changed.sample) return;
    const { sample } = player;
    const shown = {
      Speed: mps(data.ego.speed_mps[sample]), "Target speed": mps(data.target_speed_mps[sample]),
      Plan: spaced(data.plan_mode[sample] || "–"),
    };
    if (hasLight) shown["Traffic light"] = data.lights[sample] || "none";
    if (data.guard) shown.Guard = data.guard.state[sample] || "no alarm";
    const value = story && data.robustness[story.requirement][sample];
    if (story) shown[`${spaced(plainId(story.requirement))} margin`] = margin(value, data.units[story.requirement]);
    node.update(shown);
    node.classList.toggle("violated", value !== null && value < 0);
  });
  return node;
}

function mps(speed) {
  return speed === null ? "–" : `${minus(speed.toFixed(1))} m/s`;
}

function margin(value, unit) {
  if (value === null) return "not applicable";
  return `${minus(value.toFixed(Math.abs(value) < 10 ? 2 : 1))}${unit ? ` ${unit}` : ""}`;
}
