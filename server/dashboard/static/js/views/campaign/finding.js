/** What a campaign page opens with: the finding in a sentence and its figures, the best pairs as pictures, what to do next. */

import { isOpen } from "../../api.js";
import { attribute, h, keyed, replace, text } from "../../dom.js";
import { capital, count, percent, plural, rate, span } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { link } from "../../router.js";
import { callout, command, facts, meter } from "../../parts/elements.js";
import { follower } from "../pair/follow_ups.js";
import { OPENING } from "./pictures.js";

const FOLLOW_MS = 3_000;

/** Steps that are shown at once; further ones are folded. */
const STEPS = 3;

/**
 * Return the cards in one element.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {(read: object) => void} found Called with each finding.
 * @param {() => void} changed Called when a step has been taken.
 * @returns {HTMLElement} With ``news(progress)``, ``read`` (the last finding), ``hasPictures``, and ``place`` beside the next steps.
 */
export function finding(context, id, found, changed) {
  const words = h("p.lead", { "aria-live": "polite" });
  const limits = h("div");
  const of = h("p", { hidden: true });
  const told = h("div");
  const more = h("details.more", { hidden: true }, h("summary", null, "Details and limits"), told);
  const bar = meter("Simulations done");
  const figures = facts();
  const card = h("section.card.finding", { "aria-label": "Finding" }, words, limits, of, bar, figures, more);
  const place = h("div.stack.pictures");
  const next = nextSteps(context, () => {
    load(`${known} ${performance.now()}`, { atOnce: true });
    changed();
  });
  const node = h("div.stack", null, card, h("div.opening", null, place, next));
  let known = "";
  let progress = null;
  let later = null;
  const undrawn = new Set(); // kinds of which there are no pictures
  let pictures = null; // of the first kind that has any
  node.read = null;
  node.place = place;
  node.hasPictures = false;

  const load = loadOnNews(async () => {
    const read = node.read = await context.get(`campaigns/${id}/findings`);
    text(words, read.headline);
    keyed(limits, read.warnings, (one) => one, (one) => callout("warn", one));
    replace(told, read.more.map((one) => h("p", null, one)));
    more.hidden = read.more.length === 0;
    of.hidden = read.of === null;
    if (read.of) replace(of, "It follows up ", h("a", { href: link("campaigns", read.of.campaign) }, read.of.name), ".");
    if (read.complete) drawPictures(read.findings); // findings change while it runs, and the workers have better things to do
    next.update(read.steps);
    draw();
    found(read);
    clearTimeout(later);
    // Follow-ups are campaigns of their own: progress of this one does not announce their news.
    if (read.steps.some((step) => step.follow_up)) later = setTimeout(() => load(`${known} ${performance.now()}`), FOLLOW_MS);
  }, { signal: context.signal, refuse: context.complain, leastMs: 2_000 });
  context.signal.addEventListener("abort", () => clearTimeout(later), { once: true });

  /** Show something else than pictures of which none can be drawn. */
  function drawOthers(kind) {
    if (context.signal.aborted) return;
    undrawn.add(kind);
    drawPictures(node.read.findings);
    found(node.read);
  }

  function drawPictures(findings) {
    const viewOf = (kind) => findings.find((one) => one.kind === kind)?.view;
    const kind = Object.keys(OPENING).find((one) => viewOf(one) && !undrawn.has(one) && OPENING[one].has(viewOf(one)));
    if (kind !== pictures?.kind) {
      pictures?.card.remove();
      pictures = kind ? { kind, card: OPENING[kind].card(context, id, () => drawOthers(kind)) } : null;
      if (pictures) place.prepend(pictures.card);
    }
    pictures?.card.update(viewOf(kind));
    node.hasPictures = pictures !== null;
  }

  function draw() {
    if (!progress) return;
    const ended = !isOpen(progress.status);
    const numbers = node.read?.findings.filter((one) => one.role === "sought" || (one.role === "met" && !one.is_empty)).flatMap((one) => one.figures) ?? [];
    const evaluated = progress.evaluated + progress.reported;
    const unsafe = progress.unsafe + progress.reported_unsafe;
    const failed = progress.failed + progress.reported_failed;
    bar.hidden = ended;
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
    if (news !== known) load(known = news);
  };
  return node;
}

/** Return the card of what to do next; ``update`` takes the steps. */
function nextSteps(context, taken) {
  const first = h("ul.steps");
  const rest = h("ul.steps");
  const more = h("summary");
  const folded = h("details", null, more, rest);
  const card = h("section.card.next", { "aria-label": "What to do next", hidden: true }, h("h2", null, "What to do next"), first, folded);

  function stepOf(first) {
    const words = h("p");
    const action = h("div");
    const running = h("div");
    const shell = first.command && command(first.command);
    const node = h("li", null, h("h3", null, first.question), words, action, running,
      shell && (actionOf(first) ? h("details", null, h("summary.small", null, "Command"), shell) : shell));
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
    for (const [list, some] of [[first, steps.slice(0, STEPS)], [rest, steps.slice(STEPS)]]) keyed(list, some, (step) => step.kind + step.question, stepOf);
    folded.hidden = steps.length <= STEPS;
    text(more, plural(steps.length - STEPS, "more step"));
  };
  return card;
}
