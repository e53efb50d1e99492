/** Findings of any kind as cards: a sentence, and tables whose columns say how their values are written. */

import { download } from "../../api.js";
import { h, keyed, replace, text } from "../../dom.js";
import { count, figure, percent, sentence } from "../../format.js";
import { link } from "../../router.js";

const WRITTEN = { count, share: percent, number: figure, flag: (value) => (value ? "yes" : "no"), text: (value) => value };

/**
 * Return the cards in one element; ``update`` takes what the campaign found.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {string[]} apart Kinds that have a card of their own on the page.
 */
export function kindCards(context, id, apart) {
  const node = h("div.stack");

  node.update = (read) => {
    const shown = read.findings.filter((one) => !apart.includes(one.kind) && !one.is_empty);
    keyed(node, shown, (one) => one.kind, (one) => kindCard(context, id, one));
  };
  return node;
}

function kindCard(context, id, first) {
  const words = h("p");
  const more = h("div.hint");
  const tables = h("div.stack");
  const node = h("section.card", { "aria-label": first.title }, h("h2", null, first.title), words, more, tables);
  let all = false;

  node.update = (finding) => {
    if (all) return; // the reader has asked for all rows: they stay until the page is opened again
    text(words, sentence(finding.sentence));
    replace(more, finding.more.map((one) => h("p", null, sentence(one))));
    replace(tables, finding.tables.filter((table) => table.rows.length).map((table) => [
      findingTable(id, table),
      h("p", null,
        table.left_out > 0 && h("button", { type: "button", onclick: showAll }, `Show all ${count(table.rows.length + table.left_out)} rows`), " ",
        h("button.quiet", { type: "button", onclick: () => save(finding.kind, table.name) }, "CSV")),
    ]));
  };

  async function showAll() {
    const read = await context.tell(() => context.get(`campaigns/${id}/findings/${encodeURIComponent(first.kind)}`));
    if (!read) return;
    node.update(read);
    all = true;
  }

  function save(kind, table) {
    const place = `campaigns/${id}/findings/${encodeURIComponent(kind)}?format=csv&table=${encodeURIComponent(table)}`;
    return context.tell(() => download(place, `${table}-${id}.csv`));
  }

  node.update(first);
  return node;
}

/**
 * Return a table of a finding.
 *
 * @param {string} id Id of the campaign.
 * @param {{title: string, columns: object[], rows: any[][]}} table
 */
export function findingTable(id, table) {
  const shown = table.columns.map((column, place) => ({ ...column, place })).filter((column) => !column.detail);
  return h("div.scroll", { tabindex: 0, role: "region", "aria-label": table.title },
    h("table", null, h("caption", null, table.title),
      h("thead", null, h("tr", null, shown.map((column) => h("th", { scope: "col" }, column.unit ? `${column.title} (${column.unit})` : column.title)))),
      h("tbody", null, table.rows.map((row) => h("tr", null, shown.map((column) => h(isNumber(column) ? "td.right" : "td", null, cell(id, column, row[column.place]))))))));
}

function isNumber(column) {
  return ["count", "number", "share"].includes(column.format);
}

function cell(id, column, value) {
  if (value === null) return "–";
  if (column.format === "solution") return h("a", { href: link("campaigns", id, "solutions", value) }, String(value));
  return (WRITTEN[column.format] ?? String)(value);
}
