/** The differences of a pair as a table. */

import { h } from "../../dom.js";
import { capital, figure, percent, sentence } from "../../format.js";

/** Return the table of a pair's differences. */
export function differences(pair) {
  const several = pair.changes.some(({ names }) => names.length > 1) || pair.changes.length > 1;
  return h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of differences" }, h("table.differences", null,
    h("caption", null, `${several ? "Parameters" : "The parameter"} in which the two differ, ${figure(pair.distance)} apart.`),
    h("thead", null, h("tr", null, ["Parameter", "Safe", "Unsafe", "Moved, of its range", "Had a part"].map((name) => h("th", { scope: "col" }, name)))),
    h("tbody", null, pair.changes.map((change) => h("tr", { class: change.active === false ? "muted" : null },
      h("th", { scope: "row" }, change.titles.map((title) => h("div", null, title))),
      ["safe", "unsafe"].map((side) => h("td", null, change[side].map((value, place) => h("div", null, `${written(value)} ${change.units[place] ?? ""}`.trim())))),
      h("td.right", null, change.moved === null ? "another category" : percent(change.moved)),
      h("td", null, change.active === null ? "not recorded" : change.active ? "yes" : "no"))))));
}

function written(value) {
  return typeof value === "number" ? figure(value, 4) : String(value).replaceAll("_", " ");
}

/** Return words as a sentence that begins with a capital letter. */
export function said(words) {
  return sentence(capital(words));
}
