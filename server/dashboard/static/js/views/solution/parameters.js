/** The parameters of a solution: a table a component; names with a common beginning become columns. */

import { h } from "../../dom.js";
import { capital, spaced, value } from "../../format.js";

/** Return the cards of a solution's components. */
export function parameters(given) {
  return Object.entries(given).map(([component, values]) => h("section.card", { "aria-label": `Parameters: ${spaced(component)}` },
    h("h2", null, capital(spaced(component))),
    h("div.scroll.tall", { tabindex: 0, role: "region", "aria-label": `Table of ${spaced(component)}` },
      grouped(values).map((group) => (group.prefixes ? crossed(group) : plain(group, component))))));
}

function plain({ entries }, component) {
  return h("table", null, h("caption.read-out", null, `Parameters of ${spaced(component)}`),
    h("tbody", null, entries.map(([name, one]) => h("tr", null, h("th", { scope: "row" }, spaced(name)), h("td", null, value(one))))));
}

/** Return a table of groups that have the same parameters; the longer of the two goes down. */
function crossed({ prefixes, names, at }) {
  const down = prefixes.length > names.length;
  const [rows, columns] = down ? [prefixes, names] : [names, prefixes];
  return h("table", null, h("caption.read-out", null, `${prefixes.length} groups of parameters`),
    h("thead", null, h("tr", null, h("td"), columns.map((name) => h("th", { scope: "col" }, readable(name))))),
    h("tbody", null, rows.map((row) => h("tr", null, h("th", { scope: "row" }, readable(row)),
      columns.map((column) => h("td", null, value(down ? at(row, column) : at(column, row))))))));
}

function readable(name) {
  return spaced(name).replaceAll(".", " ");
}

/** Return parameters in groups: those without a dot as they are, others by all that stands before the last one. */
function grouped(values) {
  const found = new Map();
  const loose = [];
  for (const [name, one] of Object.entries(values)) {
    const dot = name.lastIndexOf(".");
    if (dot < 0) loose.push([name, one]);
    else getOr(found, name.slice(0, dot), () => new Map()).set(name.slice(dot + 1), one);
  }
  const alike = new Map();
  for (const [prefix, members] of found) {
    const names = [...members.keys()];
    getOr(alike, names.join("\n"), () => ({ prefixes: [], names, at: (group, name) => found.get(group).get(name) })).prefixes.push(prefix);
  }
  return [...(loose.length ? [{ entries: loose }] : []), ...alike.values()];
}

function getOr(mapping, key, make) {
  if (!mapping.has(key)) mapping.set(key, make());
  return mapping.get(key);
}
