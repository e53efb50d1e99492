/** Tables whose columns say how their values are written, as the coordinator sends them for findings of any kind. */

import { attribute, h, keyed, replace, text } from "../dom.js";
import { count, figure, percent, plural } from "../format.js";
import { link } from "../router.js";
import { badge } from "./elements.js";

const NUMBERS = ["count", "number", "share"];
const MANY = 12;
const WRITTEN = {
  count, share: percent, number: figure, flag: (value) => (value ? "yes" : "no"),
  state: (value) => badge(value.split(/[ ,]/)[0], value),
};

/** Return how many rows a table has, with those that were left out. */
export function total(table) {
  return table.rows.length + table.left_out;
}

/**
 * Return an element that shows a table, sorted by the column whose heading is pressed, or as a list if it has one column.
 *
 * ``update`` takes ``{title, columns, rows, left_out}``. A long table shows its first rows until the reader asks for all,
 * and has a field to find rows by their words.
 *
 * @param {string} id Id of the campaign.
 * @param {object} given
 * @param {() => Record<string, *>} given.query Query of the pages that values link to.
 * @param {() => void} given.complete Called when rows that were left out are needed.
 * @param {boolean} given.all Whether to show all rows from the start.
 */
export function tableOf(id, { query = () => ({}), complete = () => {}, all = false } = {}) {
  const caption = h("caption");
  const head = h("tr");
  const body = h("tbody");
  const filter = h("input", { type: "search", placeholder: "rain, pedestrian, 61 …", oninput: need });
  const find = h("label.find", { hidden: true }, "Find ", filter);
  const found = h("span.hint", { "aria-live": "polite" });
  const scroll = h("div.scroll", { tabindex: 0, role: "region" }, h("table.finding", null, caption, h("thead", null, head), body));
  const list = h("ul.plain");
  const name = h("h3");
  const more = h("button", { type: "button", onclick: () => { all = true; need(); } });
  const node = h("div", null, h("div.inline", null, find, found), scroll, name, list, more);
  let table = null;
  let groups = []; // columns that are shown, each with those that stand below it
  let sorting = null;

  node.update = (next) => {
    const told = JSON.stringify(next.columns);
    if (told !== head.dataset.told) {
      head.dataset.told = told;
      groups = grouped(next.columns);
      replace(head, groups.map(heading));
    }
    table = next;
    const isList = next.columns.length === 1;
    scroll.hidden = isList;
    name.hidden = list.hidden = !isList;
    text(isList ? name : caption, next.title);
    attribute(scroll, "aria-label", next.title);
    find.hidden = isList || total(next) <= MANY;
    draw();
  };

  /** Show what the reader has asked for, which takes all rows. */
  function need() {
    if (table.left_out) complete();
    draw();
  }

  function heading({ column, at }) {
    const words = column.unit ? `${column.title} (${column.unit})` : column.title;
    const button = h("button", { type: "button", onclick: () => {
      sorting = { at, falling: sorting?.at === at && !sorting.falling };
      need();
    } }, words);
    return h("th", { scope: "col", class: side(column), data: { at } }, button);
  }

  function draw() {
    const few = all ? Infinity : MANY;
    const isWhole = !table.left_out && table.rows.length <= few;
    more.hidden = isWhole || (all && !table.left_out);
    text(more, `Show all ${count(total(table))} rows`);
    if (table.columns.length === 1) return void keyed(list, table.rows.slice(0, few), ([words]) => words, ([words]) => h("li", null, words));
    const wanted = matching(filter.value);
    const rows = table.rows.filter((row) => !wanted || groups.some((group) => [group, ...group.below].some(({ at }) => wanted.test(row[at] ?? ""))));
    if (sorting) rows.sort((a, b) => compare(a[sorting.at], b[sorting.at]) * (sorting.falling ? -1 : 1) || compare(a[groups[0].at], b[groups[0].at]));
    for (const one of head.children) attribute(one, "aria-sort", sorting && Number(one.dataset.at) === sorting.at ? (sorting.falling ? "descending" : "ascending") : null);
    const places = new Map(table.rows.map((row, place) => [row, place]));
    keyed(body, rows.slice(0, few), (row) => `${places.get(row)} ${JSON.stringify(row)} ${JSON.stringify(query())}`, (row) => h("tr", null, groups.map((group) => cell(group, row))));
    text(found, wanted ? `${count(rows.length)} of ${plural(table.rows.length, "row")} match.` : "");
  }

  function cell({ column, at, below }, row) {
    const rest = below.filter((one) => row[one.at] !== null && row[one.at] !== "");
    return h("td", { class: side(column) }, linked(column, row, at), rest.map((one) => h("div.small.muted", null, linked(one.column, row, one.at))));
  }

  function linked(column, row, at) {
    const value = row[at];
    if (value === null || value === "") return "–";
    const written = (WRITTEN[column.format] ?? String)(value);
    if (column.format === "solution") return h("a", { href: link("campaigns", id, "solutions", value) }, written);
    if (!column.page) return written;
    const place = column.page.replace(/\{(\w+)\}/g, (_, other) => row[table.columns.findIndex((one) => one.name === other)]);
    return h("a.row", { href: link("campaigns", id, ...place.split("/"), query()), "aria-label": `${column.title} ${written}` }, written);
  }

  return node;
}

function grouped(columns) {
  const groups = [];
  for (const [at, column] of columns.entries()) {
    if (column.detail) continue;
    if (column.below) groups.at(-1).below.push({ column, at });
    else groups.push({ column, at, below: [] });
  }
  return groups;
}

function side(column) {
  return NUMBERS.includes(column.format) ? "right" : null;
}

/** Return an expression for texts with a word that begins with this; null for anything. */
function matching(words) {
  const wanted = words.trim().replace(/[.*+?^${}()|[\]\\]/g, "\\$&");
  return wanted ? new RegExp(`(?<![\\p{L}\\d])${wanted}`, "iu") : null;
}

/** Compare two values of a column; missing ones come last. */
function compare(a, b) {
  if (a === null || b === null) return (a === null) - (b === null);
  return typeof a === "string" ? a.localeCompare(b) : a - b;
}
