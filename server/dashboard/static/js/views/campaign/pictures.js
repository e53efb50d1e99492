/** Pictures and controls that only one kind of finding has, by kind: in the opening of a campaign's page, and in the kind's card. */

import { attribute, h, keyed, replace, text } from "../../dom.js";
import { sentence } from "../../format.js";
import { whenMade } from "../../polling.js";
import { link } from "../../router.js";
import { badge, callout, requirementBadge, workerCommand } from "../../parts/elements.js";
import { panel, thresholdCurves } from "../thresholds.js";
import { toleranceCurves } from "../tolerance.js";

const SHARPEST = 2;

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

/** Return the card of violations that a careful driver would have avoided, beside that driver's drive; ``update`` takes what only violations have. */
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

  card.update = (view) => {
    text(meaning, `Both drives from above at the moment of the violation. ${view.explanation}`);
    card.show(view.examples, (one) => String(one.number), violation);
  };
  return card;
}

/** Add the value of a number to a badge. */
function valued(mark, value) {
  mark.append(` at ${value}`);
  return mark;
}

/** Return the card of the sharpest thresholds: the curve, and the drives at both ends from above; ``update`` takes what only thresholds have. */
function sharpestThresholds(context, id) {
  const card = pictured(context, "Where exactly it turns", h("p.hint", null,
    "The same drive with a lower and a higher value of one number, from above at the decisive moment, and how likely a violation is in between. Each outlines the car of the other one."));

  function threshold(one) {
    const { safe, unsafe } = one.pair;
    const path = `campaigns/${id}/pairs/${safe.number}-${unsafe.number}`;
    const curve = panel({ ...one, computed: false });
    const facts = h("div.small.muted");
    const value = (end) => `${end.value.toFixed(one.decimals)}${one.unit ? ` ${one.unit}` : ""}`;
    const caption = h("figcaption", null, h("div", null,
      h("a", { href: link("campaigns", id, "pairs", `${safe.number}-${unsafe.number}`) }, `Threshold ${one.place}: films of both ends`)), h("div.curves", null, curve), facts);
    const node = card.figure(caption, ["safe", "unsafe"].map((side) => ({
      place: `${path}/${side}.png`, side, label: `The ${side} end of threshold ${one.place} from above, at ${value(one.pair[side])}`,
      badge: valued(requirementBadge({ kind: side === "safe" ? "held" : "violated" }), value(one.pair[side])),
    })));
    node.update = (next) => {
      curve.update({ ...next, computed: false });
      text(facts, [next.rule && sentence(next.rule), next.held && `Held: ${next.held}.`, next.blame_words && sentence(next.blame_words)].filter(Boolean).join(" "));
    };
    node.update(one);
    return node;
  }

  card.update = (view) => {
    if (!view.replayable) return;
    const shown = view.thresholds.filter((one) => one.outcome === "threshold" && one.pair).slice(0, SHARPEST);
    card.show(shown, (one) => `${one.pair.safe.number}-${one.pair.unsafe.number}`, threshold);
  };
  return card;
}

/** Return the card of the best pairs, both drives of each from above; ``update`` takes what only pairs have. */
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
      known.update(`${next.state} long`, next.evidence);
      attribute(known, "title", next.shares || null);
    };
    node.update(one);
    return node;
  }

  card.update = (view) => {
    if (!view.replayable) return;
    text(meaning, view.rule);
    card.show(view.best, (one) => `${one.safe}-${one.unsafe}`, pair);
  };
  return card;
}

/** Functions of the context and the campaign's id that return a card; ``update`` takes what only the kind has. */
export const OPENING = { thresholds: sharpestThresholds, violations: avoidableViolations, pairs: bestPairs };

/** Functions of the context and the campaign's id that return what stands ``above`` and ``below`` the tables, and ``update``. */
export const IN_CARD = { thresholds: thresholdCurves, tolerances: toleranceCurves };
