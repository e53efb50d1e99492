/** Play, pause, the scrubber with what happens marked on it, how fast, and the way to the violation. */

import { attribute, h, text } from "../../dom.js";
import { segments } from "../../parts/elements.js";

const SPEEDS = [["0.5", "0.5×"], ["1", "1×"], ["2", "2×"], ["4", "4×"]];
const TYPED = "input:not([type=range]), textarea, select, button, a, summary, [role=region]";

/** Return a time as it is shown: ``3.2 s``. */
export function seconds(time_s) {
  return `${time_s.toFixed(1)} s`;
}

/**
 * Return the controls of a player.
 *
 * @param {import("./player.js").Player} player
 * @param {{time_s: number, words: string, bad?: boolean}[]} marks What happens, and when.
 * @param {Element} stage What is played: Space plays while it is in sight, unless something else wants Space.
 */
export function controls(player, marks, stage) {
  const { episode, signal } = player;
  const long_s = Math.max(1e-6, episode.end_s - episode.start_s);
  const button = h("button.primary.play", { type: "button", onclick: () => player.toggle() }, "Play");
  const scrubber = h("input", {
    type: "range", min: 0, max: episode.last, step: 1, value: 0, "aria-label": "Time in the episode",
    oninput: () => player.show(Number(scrubber.value)),
  });
  const track = h("div.marks", { "aria-hidden": "true" }, marks.map(({ time_s, words, bad }) => {
    const mark = h(bad ? "i.bad" : "i", { title: `${seconds(time_s)}: ${words}` });
    mark.style.left = `${(100 * episode.sampleAt(time_s)) / Math.max(1, episode.last)}%`;
    return mark;
  }));
  const clock = h("output.clock.figure");
  const speeds = segments("Speed", (speed) => player.setSpeed(Number(speed)), SPEEDS, "1");
  const violation = marks.find((mark) => mark.bad);
  const jump = violation && h("button", { type: "button", onclick: () => {
    player.pause();
    player.seek(violation.time_s);
  } }, `To the violation at ${seconds(violation.time_s)}`);

  player.listen((_, changed) => {
    if (changed.time) text(clock, `${player.time_s.toFixed(1)} / ${seconds(episode.end_s)}`);
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
    if (event.target.closest?.(TYPED) || document.querySelector("dialog[open]")) return;
    const { top, bottom } = stage.getBoundingClientRect();
    if (bottom < 0 || top > innerHeight) return;
    event.preventDefault();
    player.toggle();
  }, { signal });

  return h("div.controls", { role: "group", "aria-label": "Playing" },
    button, h("div.scrub", null, track, scrubber), clock, speeds, jump);
}
