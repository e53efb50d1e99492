/** DBS and fitness over simulations, a line a campaign. */

import { h, replace } from "../../dom.js";
import { chart } from "../../parts/chart.js";

const DASHES = [[], [8, 4], [2, 3], [10, 4, 2, 4], [5, 5], [14, 4]];

/**
 * Return a place for a chart; its ``update(lines)`` draws ``{key, name, colour, points: [x, y][]}``.
 *
 * @param {string} label What it shows.
 * @param {object} context Of the view.
 * @param {object} options Of the chart: ``options`` as uPlot takes them.
 */
export function course(label, context, options = {}) {
  const place = h("div");
  let known = null;
  let own = null;
  let drawn = null;

  place.update = (lines) => {
    const told = JSON.stringify(lines.map((line) => [line.key, line.name, line.colour]));
    if (told !== known) {
      known = told;
      own?.abort();
      own = new AbortController();
      context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
      drawn = lines.length === 0 ? null : chart({
        label, x: "simulations", signal: own.signal, height: 260, options,
        series: lines.map((line, index) => ({
          label: line.name, colour: line.colour, dash: DASHES[index % DASHES.length], more: { paths: uPlot.paths.stepped({ align: 1 }) },
        })),
      });
      replace(place, drawn);
    }
    drawn?.update(joined(lines));
  };
  return place;
}

/** Return one column of all simulations, then a column a line: what was known by then, and null after its end. */
function joined(lines) {
  const all = [...new Set(lines.flatMap((line) => line.points.map(([x]) => x)))].sort((a, b) => a - b);
  return [all, ...lines.map(({ points }) => {
    const end = points.at(-1)?.[0] ?? -1;
    let next = 0;
    let last = null;
    return all.map((x) => {
      while (next < points.length && points[next][0] <= x) last = points[next++][1];
      return x <= end ? last : null;
    });
  })];
}
