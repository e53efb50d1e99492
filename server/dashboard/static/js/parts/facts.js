/** Figures with their names. */

import { h, text } from "../dom.js";

/**
 * Return a list of facts; its ``update`` takes a mapping of names to texts.
 *
 * @param {Record<string, string>} told In this order; what a later update leaves out is not shown.
 */
export function facts(told = {}) {
  const node = h("dl.facts");
  const known = new Map();
  node.update = (next) => {
    for (const [name, words] of Object.entries(next)) {
      if (!known.has(name)) {
        const value = h("dd");
        const pair = h("div", null, h("dt", null, name), value);
        known.set(name, { pair, value });
        node.append(pair);
      }
      text(known.get(name).value, words);
    }
    for (const [name, { pair }] of known) pair.hidden = !(name in next);
  };
  node.update(told);
  return node;
}
