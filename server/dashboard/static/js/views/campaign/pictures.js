/** Pictures and controls that only one kind of finding has, by kind: in the opening of a campaign's page, and in the kind's card. */

import { attribute, h, keyed, replace, text } from "../../dom.js";
import { sentence } from "../../format.js";
import { whenMade } from "../../polling.js";
import { link } from "../../router.js";
import { badge, callout, requirementBadge, workerCommand } from "../../parts/elements.js";
import { panel, thresholdCurves } from "../thresholds.js";
import { toleranceCurves } from "../tolerance.js";
import { ratePictures } from "./rate.js";

const SHARPEST = 3;
/** Height of a curve that leaves room for the pictures. */
const LOW = 84;

/**
 * Return a card of figures with two pictures from above each, which have their room before they are there.
 *
 * @param {Context} context
 * @param {string} label
 * @param {string} meaning Of the pictures.
 * @param {() => void} none Called if no picture can be drawn.
 */
function pictured(context, label, meaning, none) {
  const row = h("div.best-pairs");
  const missing = h("div", { role: "status", hidden: true });
  const reading = h("p.hint", null, meaning);
  const card = h("section.card", { "aria-label": label }, h("h2", null, label), row, missing,
    h("details", null, h("summary.hint", null, "How to read the pictures"), reading));

  /**
   * Return a figure, which has its pictures drawn.
   *
   * @param {Element} caption
   * @param {{place: string, side: string, label: string, badge: Element}[]} pictures Address, class, words, badge.
   */
  card.figure = (caption, pictures) => {
    const drawn = pictures.map(({ place, side, label: words, badge: mark }) => {
      const canvas = h("canvas", { role: "img", "aria-label": words, width: 480, height: 228 });
      return { place, canvas, node: h(`div.drive-picture.${side}`, null, mark, canvas) };
    });
    const sides = h("div.sides", null, drawn.map((each) => each.node));
    const figure = h("figure", null, caption, sides);
    draw(drawn).then((complete) => {
      sides.classList.add(complete ? "drawn" : "none");
      if (![...row.children].some((one) => !one.querySelector(".none"))) none();
    });
    return figure;
  };

  /** Draw pictures as they are made; resolves to whether there are any. */
  async function draw(drawn) {
    const passes = (error) => error.noWorker && waits();
    try {
      for (const { place, canvas } of drawn) {
        const picture = await whenMade(place, { ...context.recording(place), away: () => {}, as: "blob", passes });
        if (!picture.size) return false; // nothing of it can be drawn
        const bitmap = await createImageBitmap(picture);
        canvas.getContext("2d").drawImage(bitmap, 0, 0, canvas.width, canvas.height);
      }
    } catch (error) {
      if (!context.signal.aborted && error.status === undefined) throw error;
      return false; // a page without pictures is not worth a message
    }
    missing.hidden = true;
    return true;
  }

  /** Say that the pictures wait for a worker; they appear by themselves once one has simulated the drives. */
  function waits() {
    if (!missing.firstChild) replace(missing, callout("", "The drives were not recorded, so a worker must simulate them again before they can be shown. Start one: ", workerCommand()));
    missing.hidden = false;
    return true;
  }

  card.explain = (words) => text(reading, `${meaning} ${words}`);
  card.show = (items, key, make) => keyed(row, items, key, make);
  return card;
}

/** Return the card of violations that a careful driver would have avoided, beside that driver's drive; ``update`` takes what only violations have. */
function avoidableViolations(context, id, none) {
  const card = pictured(context, "What a careful driver would have avoided", "Both drives from above at the moment of the violation.", none);

  function violation(one) {
    const path = `campaigns/${id}/solutions/${one.number}/compared`;
    const caption = h("figcaption", null, h("div", null, h("a", { href: link("campaigns", id, "solutions", one.number) }, `Solution ${one.number}`)),
      clamped(sentence(one.words)), h("div.small.muted", null, one.type));
    return card.figure(caption, [
      { place: `${path}/system.png`, side: "unsafe", label: `The system's drive of solution ${one.number} from above`, badge: badge("unsafe", "system") },
      { place: `${path}/reference.png`, side: "safe", label: `The careful driver in place of solution ${one.number} from above`, badge: badge("safe", "careful driver") },
    ]);
  }

  card.update = (view) => {
    card.explain(view.explanation);
    card.show(view.examples.slice(0, SHARPEST), (one) => String(one.number), violation);
  };
  return card;
}

/** Return words of which a few lines are shown; a pair of distant drives can differ in a lot. */
function clamped(words) {
  return h("span.clamped", { title: words }, words);
}

/** Add the value of a number to a badge. */
function valued(mark, value) {
  mark.append(` at ${value}`);
  return mark;
}

/** Return the card of the sharpest thresholds: the curve, and the drives at both ends from above; ``update`` takes what only thresholds have. */
function sharpestThresholds(context, id, none) {
  const card = pictured(context, "Where exactly it turns",
    "How likely a violation is along one number, and the same drive at both ends, from above at the decisive moment. Each outlines the car of the other one.", none);

  function threshold(one) {
    const { safe, unsafe } = one.pair;
    const path = `campaigns/${id}/pairs/${safe.number}-${unsafe.number}`;
    const curve = panel({ ...one, computed: false }, LOW);
    const value = (end) => `${end.value.toFixed(one.decimals)}${one.unit ? ` ${one.unit}` : ""}`;
    const words = h("a.clamped", { href: link("campaigns", id, "pairs", `${safe.number}-${unsafe.number}`), title: one.words });
    const state = h("span.small.muted");
    const caption = h("figcaption", null, h("div", null, words), state, h("div.curves", { "aria-hidden": "true" }, curve));
    const node = card.figure(caption, ["safe", "unsafe"].map((side) => ({
      place: `${path}/${side}.png`, side, label: `The ${side} end of threshold ${one.place} from above, at ${value(one.pair[side])}`,
      badge: valued(requirementBadge({ kind: side === "safe" ? "held" : "violated" }), value(one.pair[side])),
    })));
    node.update = (next) => {
      curve.update({ ...next, computed: false });
      text(words, `${next.place}. ${next.words}`);
      text(state, `50% at ${next.turns}, 20 to 80% within ${next.within}; ${next.drives} drives`);
      attribute(caption, "title", [next.rule && sentence(next.rule), next.held && `Held: ${next.held}.`, next.blame_words && sentence(next.blame_words)].filter(Boolean).join(" "));
    };
    node.update(one);
    return node;
  }

  card.update = (view) => {
    card.show(sharpest(view), (one) => `${one.pair.safe.number}-${one.pair.unsafe.number}`, threshold);
  };
  return card;
}

function sharpest(view) {
  return view.thresholds.filter((one) => one.outcome === "threshold" && one.pair).slice(0, SHARPEST);
}

/** Return the card of the best pairs, both drives of each from above; ``update`` takes what only pairs have. */
function bestPairs(context, id, none) {
  const card = pictured(context, "Best pairs",
    "Two neighbouring drives, one safe and one unsafe, from above at the decisive moment. Each outlines the car of the other one.", none);

  function pair(one) {
    const path = `campaigns/${id}/pairs/${one.safe}-${one.unsafe}`;
    const known = badge("found");
    known.classList.add("long");
    const caption = h("figcaption", null,
      h("div", null, h("a", { href: link("campaigns", id, "pairs", `${one.safe}-${one.unsafe}`) }, `Pair ${one.place}`), " ", known), clamped(sentence(one.words)));
    const node = card.figure(caption, ["safe", "unsafe"].map((side) => ({
      place: `${path}/${side}.png`, side, label: `The ${side} drive of pair ${one.place} from above`,
      badge: requirementBadge({ kind: side === "safe" ? "held" : "violated" }),
    })));
    node.update = (next) => {
      known.update(`${next.state} long`, next.evidence);
      attribute(known, "title", next.shares || null);
    };
    node.update(one);
    return node;
  }

  card.update = (view) => {
    card.explain(view.rule);
    card.show(view.best, (one) => `${one.safe}-${one.unsafe}`, pair);
  };
  return card;
}

/** By kind, whether a view ``has`` pictures, and a function of the context, the campaign's id and of what to do without any that returns their ``card``; ``update`` takes the view. */
export const OPENING = {
  thresholds: { card: sharpestThresholds, has: (view) => view.replayable && sharpest(view).length > 0 },
  violations: { card: avoidableViolations, has: (view) => view.examples.length > 0 },
  pairs: { card: bestPairs, has: (view) => view.replayable && view.best.length > 0 },
};

/** Functions of the context and the campaign's id that return what stands ``above`` and ``below`` the tables, and ``update``. */
export const IN_CARD = { rate: ratePictures, thresholds: thresholdCurves, tolerances: toleranceCurves };
