/** What a campaign page opens with: the finding in a sentence and its figures, the best pairs as pictures, what to do next. */

import { isOpen } from "../../api.js";
import { attribute, h, keyed, replace, text } from "../../dom.js";
import { count, percent, rate, sentence, span } from "../../format.js";
import { loadOnNews, whenMade } from "../../polling.js";
import { link } from "../../router.js";
import { badge, callout, command, facts, meter, requirementBadge, workerCommand } from "../../parts/elements.js";
import { follower } from "../pair/follow_ups.js";

const FOLLOW_MS = 3_000;
const EVIDENCE = { confirmed: "confirmed", refuted: "refuted", undecided: "undecided" };

/**
 * Return the cards in one element.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {(read: object) => void} found Called with each finding.
 * @param {() => void} changed Called when a step has been taken.
 * @returns {HTMLElement} With ``news(progress, generations)``.
 */
export function finding(context, id, found, changed) {
  const words = h("p.lead", { "aria-live": "polite" }, "Loading what was found so far…");
  const of = h("p", { hidden: true });
  const more = h("div.more");
  const bar = meter("Simulations done");
  const figures = facts();
  const card = h("section.card.finding", { "aria-label": "Finding" }, words, of, bar, figures, more);
  const avoidable = avoidableViolations(context, id);
  const best = bestPairs(context, id);
  const next = nextSteps(context, () => {
    load(`${told} ${performance.now()}`, { atOnce: true });
    changed();
  });
  const node = h("div.stack", null, card, h("div.opening", null, h("div.stack.pictures", null, avoidable, best), next));
  let told = "";
  let read = null;
  let progress = null;
  let generations = null;
  let later = null;

  const load = loadOnNews(async () => {
    read = await context.get(`campaigns/${id}/findings`);
    text(words, read.words);
    replace(more, read.more.map((one) => h("p", null, one)));
    of.hidden = read.of === null;
    if (read.of) replace(of, "It follows up ", h("a", { href: link("campaigns", read.of.campaign) }, read.of.name), ".");
    avoidable.update(read);
    best.update(read);
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
    const last = generations.list.at(-1);
    const known = viewOf(read, "pairs")?.distinct ?? null; // null if there are too many
    const evaluated = progress.evaluated + progress.reported;
    const unsafe = progress.unsafe + progress.reported_unsafe;
    const failed = progress.failed + progress.reported_failed;
    bar.update(progress.simulations / progress.budget, ended);
    figures.update({
      ...(progress.finds[0] === "pairs" && known !== null ? { Pairs: count(known) } : {}),
      ...(progress?.finds[0] === "boundary" && last ? { "Boundary solutions (strict)": `${count(last.dbs)} (${count(last.strict_dbs)})` } : {}),
      ...(progress.finds[0] !== "pairs" && known ? { Pairs: count(known) } : {}),
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

  node.news = (now, known) => {
    [progress, generations] = [now, known];
    draw();
    const news = `${now.sequence} ${now.evaluated ? "" : now.reported} ${isOpen(now.status)}`;
    if (news !== told) load(told = news);
  };
  return node;
}

/**
 * Return a card of figures with two pictures from above each. It appears with the first figure whose pictures can be drawn.
 *
 * @param {Context} context
 * @param {string} label
 * @param {Element} hint
 */
function pictured(context, label, hint) {
  const row = h("div.best-pairs");
  const missing = h("div", { role: "status", hidden: true });
  const card = h("section.card", { "aria-label": label, hidden: true }, h("h2", null, label), hint, missing, row);

  /**
   * Return a figure that shows itself once its pictures are there.
   *
   * @param {Element} caption
   * @param {{place: string, side: string, label: string, badge: Element}[]} pictures Address, class, words, badge.
   */
  card.figure = (caption, pictures) => {
    const drawn = pictures.map(({ place, side, label: words, badge: mark }) => {
      const canvas = h("canvas", { role: "img", "aria-label": words, width: 720, height: 340 });
      return { place, canvas, node: h(`div.drive-picture.${side}`, null, mark, canvas) };
    });
    const node = h("figure", { hidden: true }, caption, drawn.map((each) => each.node));
    show(node, drawn);
    return node;
  };

  async function show(node, drawn) {
    const passes = (error) => error.noWorker && waits();
    try {
      for (const { place, canvas } of drawn) {
        const picture = await whenMade(place, { ...context.recording(place), away: () => {}, as: "blob", passes });
        if (!picture.size) return; // nothing of it can be drawn
        const bitmap = await createImageBitmap(picture);
        canvas.getContext("2d").drawImage(bitmap, 0, 0, canvas.width, canvas.height);
      }
    } catch (error) {
      if (context.signal.aborted) return;
      if (error.status === undefined) throw error;
      return; // a page without pictures is not worth a message
    }
    node.hidden = false;
    card.hidden = false;
    missing.hidden = true;
  }

  /** Say that the pictures wait for a worker; they appear by themselves once one has simulated the drives. */
  function waits() {
    if (!missing.firstChild) replace(missing, callout("", "The drives were not recorded, so a worker must simulate them again before they can be shown. Start one: ", workerCommand()));
    card.hidden = missing.hidden = false;
    return true;
  }

  card.show = (items, key, make) => keyed(row, items, key, make);
  return card;
}

/** Return what only one kind of findings has; undefined if the campaign has none of the kind. */
export function viewOf(read, kind) {
  return read?.findings.find((one) => one.kind === kind)?.view ?? undefined;
}

/** Return the card of violations that a careful driver would have avoided, beside that driver's drive; ``update`` takes the finding. */
function avoidableViolations(context, id) {
  const meaning = h("p.hint");
  const card = pictured(context, "What a careful driver would have avoided", meaning);

  function violation(one) {
    const path = `campaigns/${id}/solutions/${one.number}/compared`;
    const caption = h("figcaption", null, h("div", null, h("a", { href: link("campaigns", id, "solutions", one.number) }, `Solution ${one.number}`)),
      sentence(one.words), h("div.small.muted", null, one.type));
    return card.figure(caption, [
      { place: `${path}/system.png`, side: "unsafe", label: `The system's drive of solution ${one.number} from above`, badge: badge("unsafe", "system") },
      { place: `${path}/reference.png`, side: "safe", label: `The careful driver in place of solution ${one.number} from above`, badge: badge("safe", "careful driver") },
    ]);
  }

  card.update = (read) => {
    const view = viewOf(read, "violations");
    if (!read.complete || !view) return; // types change while it runs, and the workers have better things to do
    text(meaning, `Both drives from above at the moment of the violation. ${view.explanation}`);
    card.show(view.examples, (one) => String(one.number), violation);
  };
  return card;
}

/** Return the card of the best pairs, both drives of each from above; ``update`` takes the finding. */
function bestPairs(context, id) {
  const meaning = h("span");
  const card = pictured(context, "Best pairs", h("p.hint", null,
    "Two neighbouring drives, one safe and one unsafe, from above at the decisive moment. Each outlines the car of the other one. ", meaning));

  function pair(one) {
    const path = `campaigns/${id}/pairs/${one.safe}-${one.unsafe}`;
    const known = badge("found");
    known.classList.add("long");
    const caption = h("figcaption", null,
      h("div", null, h("a", { href: link("campaigns", id, "pairs", `${one.safe}-${one.unsafe}`) }, `Pair ${one.place}`), " ", known), sentence(one.words));
    const node = card.figure(caption, ["safe", "unsafe"].map((side) => ({
      place: `${path}/${side}.png`, side, label: `The ${side} drive of pair ${one.place} from above`,
      badge: requirementBadge({ kind: side === "safe" ? "held" : "violated" }),
    })));
    node.update = (next) => {
      known.update(`${EVIDENCE[next.state] ?? "found"} long`, next.evidence);
      attribute(known, "title", next.shares || null);
    };
    node.update(one);
    return node;
  }

  card.update = (read) => {
    const view = viewOf(read, "pairs");
    if (!read.complete || !view?.replayable) return; // pairs change while it runs, and the workers have better things to do
    text(meaning, view.rule);
    card.show(view.best, (one) => `${one.safe}-${one.unsafe}`, pair);
  };
  return card;
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
