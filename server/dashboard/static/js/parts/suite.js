/** *Add to suite*: the commands that keep drives in a suite file, which is not the coordinator's but in the user's repository. */

import { h } from "../dom.js";
import { command } from "./elements.js";

const FILE = "hazards.yaml";

/**
 * Return a button that shows the commands which add drives of a campaign to a suite.
 *
 * @param {string} id Id of the campaign.
 * @param {string} option Option of ``brink suite add`` that takes the drives.
 * @param {string} what What they are, such as ``this drive``.
 */
export function addToSuite(id, option, what) {
  return h("button", { type: "button", onclick: () => open(id, option, what) }, "Add to suite");
}

function open(id, option, what) {
  const node = h("dialog.card.suite", { "aria-labelledby": "suite-heading", onclose: () => node.remove() },
    h("h2", { id: "suite-heading" }, "Add to suite"),
    h("p", null, `A suite is a file in your repository. It keeps ${what} with every parameter and the evidence; brink suite run simulates it with each version of your system, also in a CI.`),
    copied("Add to an existing suite", `brink suite add ${FILE} ${id} ${option}`),
    copied("Start a new one", `brink suite create ${id} ${option} --out ${FILE}`),
    h("form", { method: "dialog" }, h("div.actions", null, h("button", { autofocus: true }, "Close"))));
  document.body.append(node);
  node.showModal();
  addEventListener("hashchange", () => node.close(), { once: true });
}

function copied(label, words) {
  const code = command(words);
  const done = h("span.hint", { role: "status" });
  const copy = h("button.quiet", { type: "button", onclick: async () => {
    try {
      await navigator.clipboard.writeText(code.textContent);
      done.textContent = "Copied";
    } catch {
      getSelection().selectAllChildren(code); // where the page may not write to the clipboard
      done.textContent = "Selected";
    }
  } }, "Copy");
  return h("section", null, h("div.inline", null, h("h3", null, label), copy, done), code);
}
