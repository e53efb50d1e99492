/** A course in a few pixels, beside its words. */

import { attribute, h } from "../dom.js";

const WIDTH = 96;
const HEIGHT = 24;

/** Return a line through some values; its ``update`` takes others. */
export function sparkline(label, values = []) {
  const line = h("polyline", { fill: "none", stroke: "var(--safe)", "stroke-width": 1.6, "vector-effect": "non-scaling-stroke" });
  const node = h("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, role: "img", "aria-label": label }, line);
  node.update = (next) => {
    const top = Math.max(1, ...next);
    const points = next.map((value, index) => {
      const x = next.length > 1 ? (index / (next.length - 1)) * WIDTH : WIDTH;
      return `${x.toFixed(1)},${(HEIGHT - 2 - (value / top) * (HEIGHT - 4)).toFixed(1)}`;
    });
    attribute(line, "points", points.join(" "));
    attribute(node, "aria-label", next.length ? `${label}: ${next.at(-1)} now` : `${label}: none yet`);
  };
  node.update(values);
  return node;
}
