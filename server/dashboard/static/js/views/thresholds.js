/** The curves of thresholds: how likely a drive is unsafe along one number, with every drive that says so. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { percent, sentence } from "../format.js";

const WIDTH = 260;
const HEIGHT = 130;
const MARGIN = 6;
const AROUND = 3; // what is shown on either side of a threshold, in units of its widest part

/** Return the curves of a campaign's thresholds, to stand above their table; ``update`` takes the finding. */
export function thresholdCurves() {
  const legend = h("ul.legend", { "aria-label": "Curves" },
    [["probability of a violation", h("i.key.line", { style: { "--of": "var(--unsafe)" } })], ["its 90% interval", h("i.key.interval-band")],
      ["50% point, 90% interval", h("i.reached")], ["from 20 to 80%", h("i.key.stretch")]].map(([label, key]) => h("li", null, key, label)));
  const panels = h("div.panels.curves");
  const above = h("div.thresholds", { hidden: true }, legend, panels);
  return {
    above,
    update: ({ view }) => {
      above.hidden = !view;
      legend.hidden = Boolean(view?.computed); // nothing is estimated
      keyed(panels, (view?.thresholds ?? []).map((one) => ({ ...one, computed: view.computed })), (one) => String(one.place), (one) => panel(one));
    },
  };
}

/** Return the curve of one threshold as a figure, in a picture of some height; ``update`` takes later states of it. */
export function panel(first, height = HEIGHT) {
  const heading = h("strong");
  const picture = h("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img" });
  const ends = h("div.ends.small.muted", { "aria-hidden": "true" });
  const meaning = h("div.meaning.small.muted");
  const shares = h("div.shares.small.muted", { "aria-hidden": "true" }, [1, 0.5, 0].map((at) => h("span", null, percent(at))));
  const node = h("figure.panel", null, h("figcaption", null, heading), h("div.plot", null, shares, picture, h("span"), ends, h("span"), meaning));
  let drawn = "";

  node.update = (one) => {
    const told = JSON.stringify([one.curve, one.dots, one.words]);
    if (told === drawn) return;
    drawn = told;
    const shown = range(one);
    text(heading, `${one.place}. ${sentence(one.words)}`);
    replace(ends, [shown.low, middle(one, shown), shown.high].map((at, place) => h("span", null, `${at.toFixed(one.decimals)}${place === 2 && one.unit ? ` ${one.unit}` : ""}`)));
    text(meaning, meaningOf(one));
    attribute(picture, "aria-label", `${one.words}: share of drives that are unsafe, by ${one.parameter}. ${meaningOf(one)}.`);
    replace(picture, curve(one, shown, height));
  };
  node.update(first);
  return node;
}

/** Return where a line turns, and on how many drives that rests. */
function meaningOf(one) {
  if (one.computed) return `${one.parameter}: turns ${one.turns}`;
  const drives = `${one.drives} drives`;
  if (one.outcome !== "threshold") return `${one.parameter}: ${one.outcome}; ${drives}`;
  return `${one.parameter}: 50% at ${one.turns}, from 20 to 80% within ${one.within}; ${drives}`;
}

/** Return the functions from values to places along a line and back: on a log scale, places are logarithms. */
function scale(one) {
  return one.log ? [Math.log, Math.exp] : [Number, Number];
}

function middle(one, { low, high }) {
  const [along, back] = scale(one);
  return back((along(low) + along(high)) / 2);
}

/** Return the part of the line that is shown: near the threshold if there is one, all of it otherwise. */
function range(one) {
  const [along, back] = scale(one);
  const values = [...one.dots.map((dot) => dot.value), one.curve.value[0], one.curve.value.at(-1)].map(along);
  let [low, high] = [Math.min(...values), Math.max(...values)];
  const marks = [one.at_20, one.at_80, one.low, one.high].filter((mark) => mark !== null).map(along);
  if (one.outcome === "threshold" && marks.length) {
    const [first, last] = [Math.min(...marks), Math.max(...marks)];
    const width = AROUND * Math.max(last - first, 4 * along(one.resolution));
    [low, high] = [Math.max(low, first - width), Math.min(high, last + width)];
  }
  return { low: back(low), high: back(high) };
}

function curve(one, { low, high }, height) {
  const [along] = scale(one);
  const x = (value) => MARGIN + ((along(value) - along(low)) / (along(high) - along(low) || 1)) * (WIDTH - 2 * MARGIN);
  const y = (share) => height - MARGIN - share * (height - 2 * MARGIN);
  const { value, share } = one.curve;
  const points = (shares) => shares.map((at, place) => `${x(value[place]).toFixed(1)},${y(at).toFixed(1)}`);
  const line = (given) => h("line", { "vector-effect": "non-scaling-stroke", ...given });
  const across = (at, more) => line({ x1: 0, x2: WIDTH, y1: y(at), y2: y(at), ...more });
  const sharp = one.outcome === "threshold" && one.at_20 !== null && one.at_80 !== null;
  const [from, to] = sharp ? [x(Math.min(one.at_20, one.at_80)), x(Math.max(one.at_20, one.at_80))] : [0, 0];
  return [
    sharp && h("rect", { x: from, y: 0, width: Math.max(to - from, 1), height, fill: "var(--line)", opacity: 0.8 }),
    [0, 0.5, 1].map((at) => across(at, { stroke: "var(--line)" })),
    !one.computed && [0.2, 0.8].map((at) => across(at, { stroke: "var(--muted)", "stroke-dasharray": "4 3" })),
    !one.computed && h("path", { d: `M${[...points(one.curve.high), ...points(one.curve.low).reverse()].join("L")}Z`, fill: "var(--unsafe)", opacity: 0.15 }),
    !one.computed && h("polyline", { points: points(share).join(" "), fill: "none", stroke: "var(--unsafe)", "stroke-width": 2, "vector-effect": "non-scaling-stroke" }),
    one.dots.filter((dot) => low <= dot.value && dot.value <= high).map((dot) => h("circle", {
      cx: x(dot.value), cy: y(dot.unsafe / dot.drives), r: 2 + Math.sqrt(dot.drives) * 0.8, stroke: "var(--card)",
      fill: dot.unsafe === 0 ? "var(--safe)" : dot.unsafe === dot.drives ? "var(--unsafe)" : "var(--muted)",
    })),
    sharp && !one.computed && one.middle !== null && line({ x1: x(one.low ?? low), x2: x(one.high ?? high), y1: y(0.5), y2: y(0.5), stroke: "var(--ink)", "stroke-width": 2 }),
    sharp && !one.computed && one.middle !== null && h("circle", { cx: x(one.middle), cy: y(0.5), r: 3.5, fill: "var(--ink)" }),
  ].filter(Boolean);
}
