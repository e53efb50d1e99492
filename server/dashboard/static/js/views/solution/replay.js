/** The replay of an episode: loading it, map and camera played together, controls, state, events, downloads. */

import { ApiError, saveBlob } from "../../api.js";
import { attribute, h, replace, text } from "../../dom.js";
import { capital, sentence } from "../../format.js";
import { whenMade } from "../../polling.js";
import { callout, workerCommand } from "../../parts/elements.js";
import { camera } from "./camera.js";
import { boxes, guard, robustness } from "./charts.js";
import { controls, state } from "./controls.js";
import { Episode, Player, seconds } from "./episode.js";
import { map } from "./map.js";
import { twoDrives } from "./two_drives.js";

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
  const node = h("section.card.waiting", { "aria-label": "Replay" }, h("h2", null, "Replay"), words);
  const say = (...what) => replace(words, what);

  async function load() {
    node.classList.add("waiting");
    say(h("p", null, "Loading the episode …"));
    try {
      const data = await Promise.all([paths].flat().map((path) => whenMade(`${path}/episode`, { ...context.recording(`${path}/trace`), making })));
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
    node.classList.remove("waiting");
    const retry = h("button", { type: "button", onclick: load }, "Try again");
    if (error.noWorker) {
      say(callout("warn", h("p", null, `The episode must be simulated again before it can be shown. ${sentence(error.message)}`),
        h("p", null, "Start a worker: ", workerCommand())), retry);
    } else if (error.notRecorded) {
      say(callout("", "A replay is not available: the episode was not recorded. With a token of scope user, you can have a worker simulate it again."));
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
    drawn(context, path, "mp4", name, "Film, MP4"), drawn(context, path, "png", name, "Picture, PNG"),
    spec && h("button", {
      type: "button", title: "The complete specification with its seed, to run the episode again",
      onclick: () => save(`${name}.json`, `${JSON.stringify(spec, null, 2)}\n`),
    }, "Specification, JSON"));
}

function drawn(context, path, format, name, words) {
  const button = h("button", { type: "button", onclick: async () => {
    button.disabled = true;
    text(button, "Drawing …");
    try {
      await context.tell(async () => {
        saveBlob(await whenMade(`${path}/replay.${format}`, { ...context.recording(`${path}/trace`), as: "blob" }), `${name}.${format}`);
      });
    } finally {
      button.disabled = false;
      text(button, words);
    }
  } }, words);
  return button;
}

/**
 * Return the cards of an episode, and its player. Where a reference driver avoids a violation, its drive is beside the system's.
 *
 * @param {import("../../context.js").Context} context
 * @param {object} data The response of ``GET …/episode``.
 * @param {object} solution
 * @param {string} path Of the solution.
 * @param {Element} actions Buttons next to the heading.
 */
export function replay(context, data, solution, path, actions) {
  const player = new Player(new Episode(data), context.signal);
  const { episode } = player;
  const { scenario, perturbations } = episode.words;
  const about = scenario && h("p.hint", null, [scenario, perturbations].filter(Boolean).join("; camera pictures: "));
  const stage = h("section.card.replay", { "aria-label": "Replay" }, h("div.inline", null, h("h2", null, "Replay"), actions));
  const charts = [boxes(player), robustness(player), guard(player)];
  if (data.reference) {
    const lead = compared(stage, player, data.reference, solution, about);
    const system = h("section.card", { "aria-label": "The system's camera" }, h("h2", null, "What the system saw and did"),
      h("div.grid-2", null, camera(player, path), events(player)));
    return { player: lead, cards: [stage, system, ...charts].filter(Boolean) };
  }
  const { node, legend, switches } = map(player);
  const told = avoidance(solution) ?? (solution.outcome && h("p", null, h("strong", null, sentence(solution.outcome))));
  stage.append(...[told, about].filter(Boolean));
  stage.append(h(episode.film ? "div.replay-stage.film" : "div.replay-stage", null,
    h("div", null, node, h("div.replay-under", null, legend, switches)),
    h("div.replay-side", null, camera(player, path), state(player), events(player))),
  controls(player, marks(episode, solution), stage));
  return { player, cards: [stage, ...charts].filter(Boolean) };
}

/** Fill a card with the system's drive and that of a reference driver; return the player that leads. */
function compared(stage, player, reference, solution, about) {
  const driver = new Player(new Episode(reference.drive), player.signal);
  const [system, instead] = reference.sentences;
  stage.append(...[h("p.lead", null, system, h("br"), instead), reference.avoided_by && h("p", null, reference.avoided_by),
    avoidance(solution, reference.violated), about].filter(Boolean));
  const lead = twoDrives(stage, [
    { player, badge: ["unsafe", "system"], words: "system", colour: "--unsafe" },
    { player: driver, badge: ["safe", reference.name], words: reference.name, colour: "--safe" },
  ], [...marks(player.episode, solution), ...braking(reference)].sort((a, b) => a.time_s - b.time_s));
  stage.append(h("p.hint", null, `${reference.explanation} Outlines show where the car of the other drive is at the same time.`));
  lead.hold(reference.moment_s);
  return lead;
}

function braking({ brakes_at_s, name }) {
  return brakes_at_s === null ? [] : [{ time_s: brakes_at_s, words: `the ${name} brakes` }];
}

/**
 * Return the violations of a solution, and who would have avoided them; null if that was not measured.
 *
 * @param {object} solution
 * @param {Record<string, string>} [named] Words with the moment and the names of other road users, by requirement.
 */
function avoidance({ violated }, named = {}) {
  if (!violated.some(({ avoidable }) => avoidable)) return null;
  return h("ul.avoidance", { "aria-label": "Who would have avoided the violations" },
    violated.map(({ requirement, words, time_s, avoidable, avoidable_words: by, avoided_by: how }) => {
      const told = named[requirement] ?? `${words}${time_s === null ? "" : ` at ${seconds(time_s)}`}`;
      return h("li", { class: avoidable }, `${capital(told)}${by ? `: ${by}${how === "driving on" ? ", by driving on" : ""}` : ""}.`);
    }));
}

/** Return the marks of the scrubber in order of time: the violations of the verdicts, and events. */
function marks(episode, solution) {
  const found = episode.data.events.filter(({ marked }) => marked)
    .map(({ time_s, caption, kind }) => ({ time_s, words: caption, bad: kind === "violation" }));
  for (const { time_s, words } of solution.violated) {
    if (time_s !== null) found.push({ time_s, words, bad: true });
  }
  if (!found.some((mark) => mark.bad)) {
    for (const { time_s, words } of episode.story?.violations ?? []) found.push({ time_s, words, bad: true });
  }
  return found.sort((a, b) => a.time_s - b.time_s);
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
