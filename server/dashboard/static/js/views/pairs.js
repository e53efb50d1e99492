/** The pairs of a campaign: two neighbouring solutions, one safe and one unsafe, and the change in words. */

import { isOpen } from "../api.js";
import { h, replace, text } from "../dom.js";
import { figure } from "../format.js";
import { link, rewrite } from "../router.js";
import { badge } from "../parts/elements.js";
import { addToSuite } from "../parts/suite.js";
import { tableOf } from "../parts/tables.js";
import { followUps } from "./pair/follow_ups.js";
import { said } from "./pair/words.js";

const MOST = 1000;

/** Return the place of a pair's page; ``asked`` are eps and d_th, where they are not the campaign's own. */
export function pairLink(id, pair, asked = {}) {
  return link("campaigns", id, "pairs", `${pair.safe.number}-${pair.unsafe.number}`, asked);
}

/** Return eps and d_th from the query of an address; null for the campaign's own. */
export function askedFor(query) {
  return Object.fromEntries(["eps", "d_th"].map((name) => [name, within(query.get(name))]));
}

/** Return the path of the pairs of a campaign. */
export function pairsPath(id, asked, limit = MOST) {
  const query = new URLSearchParams({ limit });
  for (const [name, value] of Object.entries(asked)) if (value !== null) query.set(name, value);
  return `campaigns/${id}/pairs?${query}`;
}

/** Return why settings are refused, as sentences. */
function reasonOf(error) {
  return error.errors.map(({ message }) => said(message)).join(" ") || said(error.message);
}

function within(written) {
  const value = Number.parseFloat(written ?? "");
  return value >= 0 && value <= 1 ? value : null;
}

export async function show(main, context, { parts, query }) {
  const campaign = await context.get(`campaigns/${encodeURIComponent(parts[1])}`);
  const { id, name } = campaign;
  context.title(`Pairs, ${name}`);
  const state = badge(campaign.status);
  const words = h("p", { "aria-live": "polite" });
  let asked = askedFor(query);
  const table = tableOf(id, { query: () => asked, all: true });
  const about = h("ul.plain.hint");
  const more = followUps(context, id, () => asked, () => polling.now({ afresh: true }));
  const fields = ["eps", "d_th"].map((name) => h("input", { id: `pairs-${name}`, name, type: "number", min: 0, max: 1, step: "any", value: asked[name] ?? "", onchange: choose }));
  replace(main,
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, name)),
    h("div.head", null, h("h1", null, "Pairs"), state, h("div.actions.push", null, addToSuite(id, "--pairs confirmed", "both drives of each confirmed pair"))),
    h("div.stack", null, h("section.card", { "aria-label": "Pairs" },
      h("div.inline", null, h("label", { title: "Largest distance between the sides of a pair" }, "eps ", fields[0]),
        h("label", { title: "Smallest distance between two pairs" }, "d_th ", fields[1])),
      words, table, about), more));

  const polling = context.watch(() => pairsPath(id, asked), (read) => {
    state.update(read.status);
    for (const field of fields) field.placeholder = figure(read[field.name]);
    text(words, said(read.note));
    table.update(read.table);
    table.hidden = read.pairs.length === 0;
    replace(about, aboutPairs(read).map((one) => h("li", null, said(one))));
    more.update(read);
  }, { busy: (read) => !read.complete || read.follow_ups.some(({ status }) => isOpen(status)), refuse });

  /** Say why there is no list, such as too many pairs; the fields stay, so that other settings can be chosen. */
  function refuse(error) {
    if (error.status !== 422) return void context.fail(error);
    text(words, reasonOf(error));
    replace(about);
    [table.hidden, more.hidden] = [true, true];
  }

  function choose() {
    asked = Object.fromEntries(fields.map((field) => [field.name, within(field.value)]));
    rewrite(asked);
    polling.now({ afresh: true });
  }
}

/** Return what the words of the list mean, and what is known of chance, in sentences. */
function aboutPairs(read) {
  if (read.pairs.length === 0 && !read.complete) return ["The page follows the search"];
  if (read.pairs.length === 0) return read.searched ? [] : ["This search was not for pairs, and holds those that it happened to find; edge@1 searches for them"];
  return [`The sides of a pair are at most ${figure(read.eps)} apart, or differ in one step of one parameter; pairs are at least ${figure(read.d_th)} apart`,
    read.blame, ...read.chance, read.caveat, ...read.legend].filter(Boolean);
}
