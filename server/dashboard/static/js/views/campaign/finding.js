/** What a campaign page opens with: the finding in a sentence and its figures, the best pairs as pictures, what to do next. */

import { isOpen } from "../../api.js";
import { attribute, h, keyed, replace, text } from "../../dom.js";
import { capital, count, percent, rate, span } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { link } from "../../router.js";
import { command, facts, meter } from "../../parts/elements.js";
import { follower } from "../pair/follow_ups.js";
import { OPENING } from "./pictures.js";

const FOLLOW_MS = 3_000;

/**
 * Return the cards in one element.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {(read: object) => void} found Called with each finding.
 * @param {() => void} changed Called when a step has been taken.
 * @returns {HTMLElement} With ``news(progress)``.
 */
export function finding(context, id, found, changed) {
  const words = h("p.lead", { "aria-live": "polite" }, "Loading what was found so far…");
  const of = h("p", { hidden: true });
  const more = h("div.more");
  const bar = meter("Simulations done");
  const figures = facts();
  const card = h("section.card.finding", { "aria-label": "Finding" }, words, of, bar, figures, more);
  const pictures = Object.entries(OPENING).map(([kind, make]) => ({ kind, card: make(context, id) }));
  const next = nextSteps(context, () => {
    load(`${told} ${performance.now()}`, { atOnce: true });
    changed();
  });
  const node = h("div.stack", null, card, h("div.opening", null, h("div.stack.pictures", null, pictures.map((one) => one.card)), next));
  let told = "";
  let read = null;
  let progress = null;
  let later = null;

  const load = loadOnNews(async () => {
    read = await context.get(`campaigns/${id}/findings`);
    text(words, read.words);
    replace(more, read.more.map((one) => h("p", null, one)));
    of.hidden = read.of === null;
    if (read.of) replace(of, "It follows up ", h("a", { href: link("campaigns", read.of.campaign) }, read.of.name), ".");
    for (const { kind, card: made } of pictures) {
      const { view } = read.findings.find((one) => one.kind === kind) ?? {};
      if (read.complete && view) made.update(view); // findings change while it runs, and the workers have better things to do
    }
    next.update(read.steps);
    draw();
    found(read);
    clearTimeout(later);
    // Follow-ups are campaigns of their own: progress of this one does not announce their news.
    if (read.steps.some((step) => step.follow_up)) later = setTimeout(() => load(`${told} ${performance.now()}`), FOLLOW_MS);
  }, { signal: context.signal, refuse: context.complain, leastMs: 2_000 });
  context.signal.addEventListener("abort", () => clearTimeout(later), { once: true });

  function draw() {
    if (!progress) return;
    const ended = !isOpen(progress.status);
    const numbers = read?.findings.filter((one) => one.role === "sought" || (one.role === "met" && !one.is_empty)).flatMap((one) => one.figures) ?? [];
    const evaluated = progress.evaluated + progress.reported;
    const unsafe = progress.unsafe + progress.reported_unsafe;
    const failed = progress.failed + progress.reported_failed;
    bar.update(progress.simulations / progress.budget, ended);
    figures.update({
      ...Object.fromEntries(numbers.map(({ term, words: name }) => [capital(name), term])),
      Unsafe: evaluated ? `${count(unsafe)} (${percent(unsafe / evaluated)})` : "–",
      Safe: evaluated ? count(evaluated - unsafe) : "–",
      Simulations: `${count(progress.simulations)} of ${count(progress.budget)}`,
      ...(ended ? { Took: span(progress.elapsed_s) } : { "Time left": span(progress.remaining_s), Rate: rate(progress.rate_per_s), Workers: count(progress.workers) }),
      ...(failed ? { Failed: count(failed) } : {}),
      ...(progress.cached ? { "From the cache": count(progress.cached) } : {}),
      ...(progress.measured ? { Measured: count(progress.measured) } : {}),
      ...(progress.quarantined ? { "In quarantine": count(progress.quarantined) } : {}),
    });
  }

  node.news = (now) => {
    progress = now;
    draw();
    const news = `${now.sequence} ${now.evaluated ? "" : now.reported} ${isOpen(now.status)}`;
    if (news !== told) load(told = news);
  };
  return node;
}

/** Return the card of what to do next; ``update`` takes the steps. */
function nextSteps(context, taken) {
  const list = h("ul.steps");
  const card = h("section.card.next", { "aria-label": "What to do next", hidden: true }, h("h2", null, "What to do next"), list);

  function stepOf(first) {
    const words = h("p");
    const action = h("div");
    const running = h("div");
    const node = h("li", null, h("h3", null, first.question), words, action, running, first.command && command(first.command));
    node.update = (step) => {
      text(words, step.words);
      if (!step.follow_up && !action.firstChild) replace(action, actionOf(step));
      else if (step.follow_up) replace(action);
      keyed(running, step.follow_up ? [step.follow_up] : [], (one) => `${one.campaign} ${one.status}`, follower);
    };
    node.update(first);
    return node;
  }

  function actionOf(step) {
    if (step.place) return h("a.button", { href: `#/${step.place}` }, step.label);
    if (!step.request || !context.may.steer) return null;
    const button = h("button", { type: "button", onclick: async () => {
      attribute(button, "disabled", "");
      const answer = await context.act("POST", step.request.path, null, { json: step.request.body });
      attribute(button, "disabled", null);
      if (answer) taken();
    } }, step.label);
    return button;
  }

  card.update = (steps) => {
    card.hidden = steps.length === 0;
    keyed(list, steps, (step) => step.kind + step.question, stepOf);
  };
  return card;
}
