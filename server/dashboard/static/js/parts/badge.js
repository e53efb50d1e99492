/** A state in a word, with a dot of its colour. */

import { attribute, h, text } from "../dom.js";

/** Return a badge; its ``update`` takes another state. */
export function badge(state, words = state) {
  const node = h("span", { class: `badge ${state}` }, words);
  node.update = (next, said = next) => {
    attribute(node, "class", `badge ${next}`);
    text(node, said);
  };
  return node;
}
