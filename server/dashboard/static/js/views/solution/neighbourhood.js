/** A solution's neighbourhood: what its fitness is made of, and the solutions nearest to it. */

import { h, replace, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { link } from "../../router.js";
import { badge } from "../../parts/elements.js";

/** Return a share of solutions as a bar from 0 to 1: interval, share, p_th. Its ``update`` takes others. */
export function intervalBar() {
  const range = h("i.range");
  const share = h("i.share");
  const edge = h("i.p-th");
  const bar = h("div.interval", { role: "img" }, range, edge, share);
  const node = h("div.interval-box", null, bar,
    h("div.interval-scale.small.muted", { "aria-hidden": "true" }, [0, 0.25, 0.5, 0.75, 1].map((at) => h("span", null, percent(at)))),
    h("ul.legend", null, h("li", null, h("i.key.share"), "share that is unsafe"), h("li", null, h("i.key.range"), "its interval"),
      h("li", null, h("i.key.p-th"), "the boundary, p_th")));
  node.update = ({ low, high, part, p_th }) => {
    range.style.left = `${100 * low}%`;
    range.style.width = `${100 * (high - low)}%`;
    share.style.left = `${100 * part}%`;
    edge.style.left = `${100 * p_th}%`;
    bar.setAttribute("aria-label", `${percent(part)} unsafe, interval ${percent(low)} to ${percent(high)}; the boundary is at ${percent(p_th)}`);
  };
  return node;
}

/** Return what a neighbourhood says, in a sentence or two. */
export function inWords({ neighbours, unsafe_neighbours, radius, interval: [low, high], p_th, confidence, looks_for_boundary }) {
  const sure = `${Number((100 * confidence).toFixed(1))}%`;
  const share = `${count(unsafe_neighbours)} of ${plural(neighbours, "solution")} within ${figure(radius)} ${unsafe_neighbours === 1 ? "is" : "are"} unsafe`;
  const told = `${share}: ${percent(unsafe_neighbours / neighbours)}, ${sure} interval ${percent(low)} to ${percent(high)}`;
  if (!looks_for_boundary) return `${told}. This search does not look for a boundary.`;
  const side = low > p_th ? ", below this interval" : high < p_th ? ", above this interval" : ", within this interval";
  return `${told}; the boundary is at ${percent(p_th)}${side}.`;
}

/** Return the cards of a solution's neighbourhood and of its neighbours; their ``update`` takes what came. */
export function neighbourhood(campaign) {
  const words = h("p", { id: "neighbourhood-words" });
  const bar = intervalBar();
  const card = h("section.card", { "aria-label": "Neighbourhood" }, h("h2", null, "Neighbourhood"), words, bar);
  const caption = h("caption");
  const rows = h("tbody");
  const table = h("section.card", { "aria-label": "Nearest solutions" }, h("h2", null, "Nearest solutions"),
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of the nearest solutions" }, h("table", null, caption,
      h("thead", null, h("tr", null, h("th", { scope: "col" }, "Solution"), h("th", { scope: "col" }, "Verdict"),
        ["Distance", "Robustness", "Fitness"].map((name) => h("th.right", { scope: "col" }, name)))),
      rows)));

  function update(read) {
    text(words, inWords(read));
    bar.update({ low: read.interval[0], high: read.interval[1], part: read.unsafe_neighbours / read.neighbours, p_th: read.p_th });
    text(caption, `The ${plural(read.nearest.length, "nearest", "nearest")} of ${count(read.evaluated)} evaluated; those within ${figure(read.radius)} are its neighbours.`);
    replace(rows, read.nearest.map((one) => h("tr", null,
      h("th", { scope: "row" }, h("a.row", { href: link("campaigns", campaign.id, "solutions", one.number) }, String(one.number))),
      h("td", null, badge(one.unsafe ? "unsafe" : "safe")),
      h("td.right", null, figure(one.distance), h("span.read-out", null, one.within ? ", a neighbour" : ""), !one.within && h("span.small.muted", null, " beyond")),
      h("td.right", null, figure(one.robustness)), h("td.right", null, figure(one.fitness)))));
  }
  return { card, table, update };
}
