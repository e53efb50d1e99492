/** The distinct boundary solutions: filtered, sorted, saved. */

import { download } from "../../api.js";
import { attribute, h, keyed, text } from "../../dom.js";
import { count, figure, percent, plural } from "../../format.js";
import { sparing } from "../../sparing.js";
import { badge } from "../../parts/badge.js";
import { link } from "../../router.js";

const COLUMNS = [
  ["number", "Solution", (one) => one.number],
  ["verdict", "Verdict", (one) => one.verdict],
  ["fitness", "Fitness", (one) => one.fitness],
  ["robustness", "Robustness", (one) => one.robustness],
  ["unsafe", "Unsafe around it", (one) => one.unsafe_neighbours / one.neighbours],
  ["words", "What it is", null],
];
const PAGE = 12;

/** Return the card; ``news(generation, thresholds)`` loads what is new, ``found`` is called with the numbers. */
export function boundaryCard(context, id, found) {
  let read = null;
  let thresholds = null;
  let sorting = { name: "fitness", falling: false };
  let most = PAGE;

  const filter = h("input", { id: "boundary-find", type: "search", placeholder: "rain, pedestrian, 61 …", oninput: draw });
  const verdict = h("select", { id: "boundary-verdict", onchange: draw },
    [["", "any verdict"], ["safe", "safe"], ["unsafe", "unsafe"]].map(([value, words]) => h("option", { value }, words)));
  const strict = h("input", { type: "checkbox", id: "boundary-strict", onchange: draw });
  const body = h("tbody");
  const heads = COLUMNS.map(([name, words, by]) => h(by ? "th" : "th", { scope: "col" },
    by ? h("button", { type: "button", onclick: () => sort(name) }, words) : words));
  const said = h("p.hint", { "aria-live": "polite" });
  const more = h("button", { type: "button", hidden: true, onclick: () => { most += PAGE; draw(); } }, "Show more");
  const save = (format, words) => h("button", { type: "button", onclick: () => context.tell(() => download(
    `campaigns/${id}/boundary?t_b=${thresholds.t_b}&d_th=${thresholds.d_th}&format=${format}`, `boundary-${id}.${format}`)) }, words);
  const card = h("section.card", { "aria-label": "Boundary solutions", hidden: true },
    h("div.inline", null, h("h2", null, "Boundary solutions"), h("label", { for: "boundary-find" }, "Find"), filter, verdict,
      h("label.check", { for: "boundary-strict" }, strict, "strict only"),
      h("div.actions.push", null, save("csv", "CSV"), save("jsonl", "JSON Lines"))),
    h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of boundary solutions" },
      h("table.boundary", null, h("caption", null, ""), h("thead", null, h("tr", null, heads)), body)),
    said, more);
  attribute(verdict, "aria-label", "Verdict");
  const caption = card.querySelector("caption");

  const load = sparing(async () => {
    read = await context.get(`campaigns/${id}/boundary?t_b=${thresholds.t_b}&d_th=${thresholds.d_th}`);
    card.hidden = false;
    found(read.solutions.map((one) => one.number));
    draw();
  }, { signal: context.signal, refuse: context.complain, leastMs: 3_000, share: 0.05 });

  function sort(name) {
    sorting = { name, falling: sorting.name === name ? !sorting.falling : false };
    draw();
  }

  function draw() {
    if (!read) return;
    const strictOnes = new Set(read.strict);
    const wanted = filter.value.trim().toLowerCase();
    const rows = read.solutions.filter((one) => (!verdict.value || one.verdict === verdict.value)
      && (!strict.checked || strictOnes.has(one.number))
      && (!wanted || String(one.number) === wanted || one.words.toLowerCase().includes(wanted)));
    const [, , by] = COLUMNS.find(([name]) => name === sorting.name);
    rows.sort((a, b) => (by(a) < by(b) ? -1 : by(a) > by(b) ? 1 : a.number - b.number) * (sorting.falling ? -1 : 1));
    heads.forEach((head, place) => attribute(head, "aria-sort",
      COLUMNS[place][0] === sorting.name ? (sorting.falling ? "descending" : "ascending") : null));
    keyed(body, rows.slice(0, most), (one) => `${one.number} ${one.neighbours} ${one.fitness} ${strictOnes.has(one.number)}`, (one) => row(one, strictOnes.has(one.number)));
    text(caption, `t_b ${read.t_b}, d_th ${read.d_th}: ${plural(read.dbs, "distinct boundary solution")}, ${count(read.strict_dbs)} strict. ${read.note}`);
    text(said, rows.length < read.solutions.length ? `${count(rows.length)} of ${count(read.solutions.length)} are like that.` : read.solutions.length ? "" : "None yet at these thresholds.");
    more.hidden = rows.length <= most;
  }

  function row(one, isStrict) {
    const [low, high] = one.interval;
    return h("tr", null,
      h("td", null, h("a.row", { href: link("campaigns", id, "solutions", one.number) }, String(one.number)), isStrict && h("span.small.muted", null, " strict")),
      h("td", null, badge(one.verdict)), h("td", null, figure(one.fitness)), h("td", null, figure(one.robustness)),
      h("td", null, `${one.unsafe_neighbours} of ${one.neighbours}`, h("div.small.muted", null, `${percent(low)} to ${percent(high)}`)),
      h("td.words.small", null, one.words));
  }

  card.news = (generation, next, { atOnce = false } = {}) => {
    thresholds = next;
    load(`${generation} ${next.t_b} ${next.d_th}`, { atOnce });
  };
  return card;
}
