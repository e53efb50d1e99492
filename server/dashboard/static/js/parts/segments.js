/** A few choices side by side, one of them taken. */

import { attribute, h, keyed, text } from "../dom.js";

/**
 * Return a group of buttons; its ``update(choices, chosen)`` takes others.
 *
 * @param {string} label What is chosen.
 * @param {(value: string) => void} choose Called with what was taken.
 * @param {[value: string, words: string][]} choices
 * @param {string} chosen
 */
export function segments(label, choose, choices = [], chosen = "") {
  const node = h("div.segments", { role: "group", "aria-label": label });
  node.update = (next, taken) => {
    keyed(node, next, ([value]) => value, ([value]) => {
      const button = h("button", { type: "button", onclick: () => choose(value) });
      button.update = ([, words]) => text(button, words);
      return button;
    });
    for (const [index, button] of [...node.children].entries()) {
      button.update(next[index]);
      attribute(button, "aria-pressed", String(next[index][0] === taken));
    }
  };
  node.update(choices, chosen);
  return node;
}
