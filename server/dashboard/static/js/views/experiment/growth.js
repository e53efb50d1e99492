/** DBS over the share of the budget: the mean of a method's repeats in a band from the least to the most. */

import { h, replace } from "../../dom.js";
import { percent } from "../../format.js";
import { chart } from "../../parts/chart.js";
import { colour } from "../../theme.js";

const DASHES = [[], [8, 4], [2, 3], [10, 4, 2, 4], [5, 5], [14, 4]];

/** Return a place for the chart; its ``update(fractions, lines, controls)`` draws it. */
export function growth(label, context) {
  const place = h("div");
  let known = null;
  let drawn = null;
  let bands = [];
  let own = null;

  place.update = (fractions, lines, controls) => {
    const told = JSON.stringify([lines.map((line) => line.method), controls.map((line) => line.method)]);
    if (told !== known) {
      known = told;
      own?.abort();
      own = new AbortController();
      context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
      drawn = chart({
        label, x: "share of the budget", signal: own.signal, height: 260,
        series: [...lines.map((line, index) => ({ label: line.method, colour: line.colour, dash: DASHES[index % DASHES.length], points: true })),
          ...controls.map((line) => ({ label: `${line.method}, control`, colour: line.colour, width: 1, dash: [3, 3] }))],
        options: {
          scales: { x: { time: false, range: [0, 1.02] }, y: { range: (plot, least, most) => [0, Math.max(1, most ?? 1, ...bands.flatMap((band) => band.most)) * 1.04] } },
          axes: [{ values: (plot, splits) => splits.map(percent) }, {}],
          hooks: { drawClear: [(plot) => drawBands(plot, fractions, bands)] },
        },
      });
      replace(place, drawn);
    }
    bands = lines;
    drawn.update([fractions, ...lines.map((line) => line.means), ...controls.map((line) => line.means)]);
  };
  return place;
}

function drawBands(plot, fractions, bands) {
  const canvas = plot.ctx;
  const x = (value) => plot.valToPos(value, "x", true);
  const y = (value) => plot.valToPos(value, "y", true);
  canvas.save();
  canvas.globalAlpha = 0.14;
  for (const band of bands) {
    canvas.fillStyle = colour(band.colour);
    canvas.beginPath();
    fractions.forEach((share, index) => canvas.lineTo(x(share), y(band.most[index])));
    [...fractions].reverse().forEach((share, index) => canvas.lineTo(x(share), y(band.least[fractions.length - 1 - index])));
    canvas.fill();
  }
  canvas.restore();
}
