/** A table of few columns and few rows that keeps its cells: only their words change. */

import { h, keyed, replace, text } from "../dom.js";

/**
 * Return a table; its ``update(columns, rows)`` takes others.
 *
 * @param {string} label What it shows.
 * @param {string} corner Heading of the first column.
 *
 * Columns have a ``key`` and a ``head``: words, or a function that makes a node once. Rows have a ``key``, a ``label``
 * (words), optionally a ``class``, and ``cells``, one word or figure a column.
 */
export function matrix(label, corner, { right = true } = {}) {
  const head = h("tr");
  const body = h("tbody");
  const node = h("div.scroll", { tabindex: 0, role: "region", "aria-label": label },
    h("table.matrix", null, h("caption.read-out", null, label), h("thead", null, head), body));
  const side = right ? "right" : "left";
  let known = null;

  function matrixRow(first) {
    const name = h("th", { scope: "row", class: first.class });
    const cells = first.cells.map(() => h("td", { class: [side, first.class].filter(Boolean).join(" ") }));
    const made = h("tr", null, name, cells);
    made.update = (row) => {
      text(name, row.label);
      cells.forEach((cell, index) => text(cell, row.cells[index]));
    };
    made.update(first);
    return made;
  }

  node.update = (columns, rows) => {
    const told = JSON.stringify(columns.map((column) => column.key));
    if (told !== known) {
      known = told;
      body.replaceChildren();
      replace(head, h("th", { scope: "col" }, corner), columns.map((column) =>
        h("th", { scope: "col", class: side }, typeof column.head === "function" ? column.head() : column.head)));
    }
    keyed(body, rows, (row) => row.key, matrixRow);
  };
  return node;
}
