/** Something that must not be overlooked. */

import { h } from "../dom.js";
import { currentToken } from "../session.js";

/** Return a callout; ``kind`` is ``warn``, ``bad`` or empty. */
export function callout(kind, ...words) {
  return h("div", { class: `callout ${kind}`.trim() }, words);
}

/** Return the command that starts a worker for this coordinator. */
export function workerCommand() {
  const server = new URL(".", document.baseURI).href.replace(/\/$/, "");
  return h("code", null, `${currentToken() ? "BRINK_TOKEN=… " : ""}brink worker --server ${server}`);
}
