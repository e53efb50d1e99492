/** The replay of an episode: loading it, map and camera played together, controls, state, events, downloads. */

import { ApiError, saveBlob } from "../../api.js";
import { attribute, h, replace, text } from "../../dom.js";
import { minus, plainId, sentence, spaced } from "../../format.js";
import { whenMade } from "../../polling.js";
import { callout, facts, segments, workerCommand } from "../../parts/elements.js";
import { camera } from "./camera.js";
import { boxes, robustness } from "./charts.js";
import { Episode, Player, seconds } from "./episode.js";
import { map } from "./map.js";

const SPEEDS = [["0.5", "0.5×"], ["1", "1×"], ["2", "2×"], ["4", "4×"]];
const TAKES_SPACE = "input:not([type=range]), textarea, select, button, a, summary, [role=region]";
const MOST_EVENTS = 300;

/**
 * Return a card that loads episodes and reports the progress; the card removes itself when they are there.
 *
 * @param {import("../../context.js").Context} context
 * @param {string | string[]} paths Of the solutions.
 * @param {(...data: object[]) => void} take Called with the episodes.
 */
export function loading(context, paths, take) {
  const words = h("div", { role: "status" });
  const node = h("section.card", { "aria-label": "Replay" }, h("h2", null, "Replay"), words);
  const say = (...what) => replace(words, what);

  async function load() {
    say(h("p", null, "Loading the episode …"));
    try {
      const data = await Promise.all([paths].flat().map((path) => whenMade(`${path}/episode`, { ...context.retrying, making })));
      node.remove();
      take(...data);
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) context.signIn();
      else fail(error);
    }
  }

  function making() {
    say(h("p", null, "The trace was not kept, so a worker is simulating the episode again, exactly as before. This takes a few seconds once a worker is free."));
  }

  function fail(error) {
    const retry = h("button", { type: "button", onclick: load }, "Try again");
    if (error.noWorker) {
      say(callout("warn", h("p", null, `The episode must be simulated again before it can be shown. ${sentence(error.message)}`),
        h("p", null, "Start a worker: ", workerCommand())), retry);
    } else {
      say(callout("", `A replay is not available. ${sentence(error.message)}`), error.status === 409 && retry);
    }
  }

  load();
  return node;
}

/** Return the buttons that save a solution's replay as a film or a picture, and its specification. */
export function downloads(context, path, name, spec) {
  const save = (file, content) => saveBlob(new Blob([content], { type: "application/json" }), file);
  return h("div.actions", { role: "group", "aria-label": "Save" },
    drawn(context, `${path}/replay.mp4`, `${name}.mp4`, "Film, MP4"), drawn(context, `${path}/replay.png`, `${name}.png`, "Picture, PNG"),
    spec && h("button", {
      type: "button", title: "The complete specification with its seed, to run the episode again",
      onclick: () => save(`${name}.json`, `${JSON.stringify(spec, null, 2)}\n`),
    }, "Specification, JSON"));
}

function drawn(context, path, file, words) {
  const button = h("button", { type: "button", onclick: async () => {
    button.disabled = true;
    text(button, "Drawing …");
    try {
      await context.tell(async () => {
        saveBlob(await whenMade(path, { ...context.retrying, as: "blob" }), file);
      });
    } finally {
      button.disabled = false;
      text(button, words);
    }
  } }, words);
  return button;
}

/**
 * Return the cards of an episode, and its player.
 *
 * @param {import("../../context.js").Context} context
 * @param {object} data The response of ``GET …/episode``.
 * @param {object} solution
 * @param {string} path Of the solution.
 * @param {Element} actions Buttons next to the heading.
 */
export function replay(context, data, solution, path, actions) {
  const episode = new Episode(data);
  const player = new Player(episode, context.signal);
  const { node, legend, switches } = map(player);
  const { scenario, perturbations } = episode.words;
  const stage = h("section.card.replay", { "aria-label": "Replay" },
    h("div.inline", null, h("h2", null, "Replay"), actions),
    solution.outcome && h("p", null, h("strong", null, sentence(solution.outcome))),
    scenario && h("p.hint", null, [scenario, perturbations].filter(Boolean).join("; camera pictures: ")));
  stage.append(h(episode.film ? "div.replay-stage.film" : "div.replay-stage", null,
    h("div", null, node, h("div.replay-under", null, legend, switches)),
    h("div.replay-side", null, camera(player, path), state(player), events(player))),
  controls(player, marks(episode, solution), stage));
  return { player, cards: [stage, boxes(player), robustness(player)].filter(Boolean) };
}

/** Return the marks of the scrubber in order of time: the violations of the verdicts, and events. */
function marks(episode, solution) {
  const found = episode.data.events.filter(({ marked }) => marked)
    .map(({ time_s, caption, kind }) => ({ time_s, words: caption, bad: kind === "violation" }));
  for (const { time_s, words } of solution.violated) {
    if (time_s !== null) found.push({ time_s, words, bad: true });
  }
  if (!found.some((mark) => mark.bad)) {
    for (const { sample, words } of episode.story?.violations ?? []) found.push({ time_s: episode.times[sample], words, bad: true });
  }
  return found.sort((a, b) => a.time_s - b.time_s);
}

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
  const track = h("div.marks", { "aria-hidden": "true" }, marks.map(({ time_s, words, bad }) => {
    const mark = h(bad ? "i.bad" : "i", { title: `${seconds(time_s)}: ${words}` });
    mark.style.left = `${(100 * episode.sampleAt(time_s)) / Math.max(1, episode.last)}%`;
    return mark;
  }));
  const clock = h("output.clock.figure");
  const speeds = segments("Speed", (speed) => player.setSpeed(Number(speed)), SPEEDS, "1");
  const violation = marks.find((mark) => mark.bad);
  const jump = violation && h("button", { type: "button", onclick: () => player.hold(violation.time_s) }, `Go to ${seconds(violation.time_s)}: ${violation.words.replace(/ at [\d.]+ s$/, "")}`);

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
    if (event.target.closest?.(TAKES_SPACE) || document.querySelector("dialog[open]")) return;
    const { top, bottom } = stage.getBoundingClientRect();
    if (bottom < 0 || top > innerHeight) return;
    event.preventDefault();
    player.toggle();
  }, { signal });

  return h("div.controls", { role: "group", "aria-label": "Playback" },
    button, h("div.scrub", null, track, scrubber), clock, speeds, jump);
}

/** Return the state of a player's episode in words: speed, plan, traffic light and robustness. */
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

/** Return the events of a player's episode as a list; a click jumps to an event. */
function events(player) {
  const { episode, signal } = player;
  const listed = episode.data.events.slice(0, MOST_EVENTS);
  const more = episode.data.events.length - listed.length;
  if (listed.length === 0) return h("div.replay-events", null, h("h3", null, "Events"), h("p.hint", null, "None recorded."));
  const items = listed.map(({ kind, time_s, caption }) => h("li", { class: kind },
    h("button.quiet.figure", { type: "button", onclick: () => player.hold(time_s) }, seconds(time_s)), h("span", null, caption)));
  const list = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Events in chronological order" }, h("ol", null, items));
  let current = -1;
  player.listen((_, changed) => {
    if (!changed.sample || signal.aborted) return;
    const now_s = episode.times[player.sample] + 1e-3;
    const at = listed.findLastIndex((event) => event.time_s <= now_s);
    if (at === current) return;
    attribute(items[current] ?? list, "aria-current", null);
    current = at;
    if (!items[at]) return;
    attribute(items[at], "aria-current", "time");
    const hidden = items[at].offsetTop < list.scrollTop || items[at].offsetTop + items[at].offsetHeight > list.scrollTop + list.clientHeight;
    if (hidden) list.scrollTop = items[at].offsetTop - list.clientHeight / 2;
  });
  const node = h("div.replay-events", null, h("h3", null, "Events"), list);
  if (more > 0) node.append(h("p.hint", null, `And ${more} more.`));
  return node;
}
