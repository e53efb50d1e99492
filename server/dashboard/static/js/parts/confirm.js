/** Asks before something that cannot be undone. */

import { h } from "../dom.js";

/** Ask; resolves to whether it is wanted. */
export function sure(question, { yes = "Yes", danger = true } = {}) {
  return new Promise((resolve) => {
    const node = h("dialog.card", { "aria-label": question, onclose: () => {
      node.remove();
      resolve(node.returnValue === "yes");
    } }, h("form", { method: "dialog" }, h("p", null, question), h("div.actions", null,
      h(danger ? "button.danger" : "button.primary", { value: "yes" }, yes), h("button", { value: "no", autofocus: true }, "No"))));
    document.body.append(node);
    node.showModal();
    addEventListener("hashchange", () => node.close("no"), { once: true }); // the view that asked is gone
  });
}
