/** How much of something is done. */

import { attribute, h } from "../dom.js";

/** Return a meter; its ``update(share, ended)`` changes it. */
export function meter(label, share = 0, ended = false) {
  const bar = h("i");
  const node = h("div.meter", { role: "progressbar", "aria-label": label, "aria-valuemin": 0, "aria-valuemax": 100 }, bar);
  node.update = (next, over = false) => {
    const whole = Math.round(100 * Math.min(1, Math.max(0, next)));
    bar.style.width = `${whole}%`;
    attribute(node, "aria-valuenow", whole);
    node.classList.toggle("ended", over);
  };
  node.update(share, ended);
  return node;
}
