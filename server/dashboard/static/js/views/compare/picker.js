/** Which campaigns are compared: a list to tick, found by name. */

import { rowsOf } from "../../columns.js";
import { attribute, h, keyed, text } from "../../dom.js";
import { count, plainId } from "../../format.js";

export const MOST = 6;
const LISTED = 30;

/**
 * Return the list.
 *
 * @param {object} context Of the view.
 * @param {() => string[]} chosen The ids that are compared.
 * @param {(ids: string[]) => void} choose Called with others.
 * @returns {HTMLElement} With ``update()``, for when others are chosen elsewhere.
 */
export function picker(context, chosen, choose) {
  const search = h("input", { type: "search", placeholder: "Name or id", oninput: searched });
  const list = h("ul.picks");
  const said = h("p.hint", { role: "status" });
  const node = h("div.picker", null, h("label", null, "Find ", search), list, said);
  let found = [];
  let more = false;
  let waiting = null;
  context.signal.addEventListener("abort", () => clearTimeout(waiting), { once: true });
  const listing = context.watch(() => `overview?${new URLSearchParams({ limit: LISTED, name: search.value.trim() })}`, (read) => {
    found = rowsOf(read);
    more = read.next !== null;
    node.update();
  });

  function searched() {
    clearTimeout(waiting);
    waiting = setTimeout(listing.now, 250);
  }

  function turn(id, on) {
    choose(on ? [...chosen(), id] : chosen().filter((other) => other !== id));
  }

  node.update = () => {
    const ids = chosen();
    const full = ids.length >= MOST;
    keyed(list, found.map((row) => ({ ...row, on: ids.includes(row.id), full })), (row) => row.id, (row) => pick(row, turn));
    text(said, [
      full ? `${MOST} are chosen, which is the most that can be told apart: take one away to add another.` : `${count(ids.length)} chosen; at most ${MOST}.`,
      found.length === 0 ? "No campaign is like that." : more ? `The latest ${count(found.length)} are listed: find others by name.` : "",
    ].join(" ").trim());
  };
  return node;
}

function pick(first, turn) {
  const box = h("input", { type: "checkbox", onchange: () => turn(first.id, box.checked) });
  const about = h("span.small.muted");
  const node = h("li", null, h("label.check", null, box, h("span", null, first.name, " ", about)));
  node.update = (row) => {
    box.checked = row.on;
    box.disabled = row.full && !row.on;
    attribute(node, "class", row.on ? "on" : null);
    text(about, `${row.id}, ${plainId(row.problem)}, ${plainId(row.algorithm)}, seed ${row.seed}, ${row.status}`);
  };
  node.update(first);
  return node;
}
