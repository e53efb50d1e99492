/** What only rates have in their card: the interval against simulations, with the claim, and the rates in parts of operation. */

import { h } from "../../dom.js";
import { figure } from "../../format.js";
import { chart, intervals } from "../../parts/charts.js";

const MOST_STRATA = 16;

/** Return the pictures of a rate, above its tables; ``update`` takes the finding. */
export function ratePictures(context) {
  const shares = { values: (_, marks) => marks.map(said) };
  const looks = chart({
    label: "The rate and its interval against the number of simulations", x: "simulations", signal: context.signal, height: 260,
    series: [
      { label: "rate", colour: "--ink", more: { value: (_, value) => said(value) } },
      { label: "from", colour: "--series-1", width: 1, more: { value: (_, value) => said(value) } },
      { label: "to", colour: "--series-1", width: 1, more: { value: (_, value) => said(value) } },
      { label: "claim", colour: "--unsafe", dash: [6, 4], more: { value: (_, value) => said(value) } },
    ],
    options: {
      axes: [{}, shares],
      scales: { x: { time: false, distr: 3 }, y: { range: () => [0, top] } },
      bands: [{ series: [3, 2], fill: "rgb(0 114 178 / .18)" }],
    },
  });
  const parts = intervals("Rates in parts of operation, %, with their intervals");
  const partsOf = h("div", { hidden: true }, h("h3", null, "Rates in parts of operation, %"), parts);
  const looked = h("div", { hidden: true }, looks, h("p.hint", null,
    "With the confidence of the interval, the band contains the rate at all numbers of simulations at once. Simulations are on a log scale."));
  let top = 1;

  return {
    above: h("div.stack", null, looked, partsOf),
    update({ view }) {
      looked.hidden = !(view?.looks.length > 1);
      partsOf.hidden = !view?.strata.some((one) => one.rate);
      if (!looked.hidden) {
        const limit = view.claim?.at_most ?? null;
        top = Math.min(1, 3 * Math.max(view.rate.high, limit ?? 0));
        looks.update([view.looks.map((one) => one.simulations), ...["rate", "low", "high"].map((name) => view.looks.map((one) => one[name])),
          view.looks.map(() => limit)]);
      }
      parts.update((view?.strata ?? []).filter((one) => one.rate).slice(0, MOST_STRATA).map((one) => ({
        key: one.words, label: one.words, colour: "--series-1", values: [],
        mean: 100 * one.rate.value, low: 100 * one.rate.low, high: 100 * one.rate.high,
      })));
    },
  };
}

function said(value) {
  return value === null || value === undefined ? "–" : `${figure(100 * value)}%`;
}
