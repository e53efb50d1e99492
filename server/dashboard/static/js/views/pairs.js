/** The pairs of a campaign: two neighbouring solutions, one safe and one unsafe, and the change in words. */

import { isOpen } from "../api.js";
import { h, keyed, replace, text } from "../dom.js";
import { capital, count, figure, plural } from "../format.js";
import { loadOnNews } from "../polling.js";
import { link, rewrite } from "../router.js";
import { badge, outcomeBadge } from "../parts/elements.js";
import { followUps } from "./pair/follow_ups.js";
import { evidence, findings, said, share } from "./pair/words.js";

const MOST = 1000;
const FEW = 5;

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
  const table = pairTable(id, () => asked);
  const about = h("p.hint");
  const more = followUps(context, id, () => asked, () => polling.now({ afresh: true }));
  const fields = ["eps", "d_th"].map((name) => h("input", { id: `pairs-${name}`, name, type: "number", min: 0, max: 1, step: "any", value: asked[name] ?? "", onchange: choose }));
  replace(main,
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, name)),
    h("div.head", null, h("h1", null, "Pairs"), state),
    h("div.stack", null, h("section.card", { "aria-label": "Pairs" },
      h("div.inline", null, h("label", { title: "Largest distance between the sides of a pair" }, "eps ", fields[0]),
        h("label", { title: "Smallest distance between two pairs" }, "d_th ", fields[1])),
      words, table, about), more));

  const polling = context.watch(() => pairsPath(id, asked), (read) => {
    state.update(read.status);
    for (const field of fields) field.placeholder = figure(read[field.name]);
    text(words, said(read.note));
    table.update(read);
    text(about, aboutPairs(read));
    more.update(read);
  }, { busy: (read) => !read.complete || read.follow_ups.some(({ status }) => isOpen(status)), refuse });

  /** Say why there is no list, such as too many pairs; the fields stay, so that other settings can be chosen. */
  function refuse(error) {
    if (error.status !== 422) return void context.fail(error);
    text(words, reasonOf(error));
    text(about, "");
    [table.hidden, more.hidden] = [true, true];
  }

  function choose() {
    asked = Object.fromEntries(fields.map((field) => [field.name, within(field.value)]));
    rewrite(asked);
    polling.now({ afresh: true });
  }
}

/** Return the card of a campaign's first pairs; ``news(sequence)`` loads them. */
export function pairsCard(context, id) {
  const words = h("p", { "aria-live": "polite" });
  const table = pairTable(id, () => ({}));
  const all = h("a.button", { href: link("campaigns", id, "pairs") }, "All pairs");
  const card = h("section.card", { "aria-label": "Pairs across the boundary", hidden: true },
    h("div.inline", null, h("h2", null, "Pairs across the boundary"), h("div.actions.push", null, all)),
    h("p.hint", null, "Two neighbouring solutions, one safe and one unsafe, what changes between them, and how far."), words, table);
  const load = loadOnNews(async () => {
    const read = await context.get(pairsPath(id, {}, FEW));
    card.hidden = read.evaluated === 0;
    text(words, said(read.note));
    table.update(read);
    all.hidden = read.distinct === 0;
    text(all, read.distinct > FEW ? `All ${count(read.distinct)} pairs` : "Open pairs");
  }, { signal: context.signal, refuse, leastMs: 3_000, share: 0.05 });

  function refuse(error) {
    card.hidden = error.status !== 422;
    text(words, reasonOf(error));
    table.hidden = true;
    all.hidden = false;
    text(all, "Choose other settings");
  }

  card.news = (news) => load(news);
  return card;
}

function aboutPairs(read) {
  if (read.pairs.length === 0) return !read.complete ? "The page follows the search." : read.searched ? "" : "This search was not for pairs, and holds those that it happened to find; edge@1 searches for them.";
  const sentences = [`The sides of a pair are at most ${figure(read.eps)} apart, or differ in one step of one parameter; pairs are at least ${figure(read.d_th)} apart.`];
  sentences.push(...[read.blame, ...read.chance].filter(Boolean).map((words) => `${words}.`));
  if (read.distinct > read.pairs.length) sentences.push(`Only the first ${count(read.pairs.length)} of ${count(read.distinct)} are shown.`);
  return sentences.join(" ");
}

/** Return a table of pairs in words; ``update`` takes the response of the API, ``asked`` returns eps and d_th for links. */
function pairTable(id, asked) {
  const body = h("tbody");
  const node = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of pairs", hidden: true }, h("table.pairs", null,
    h("caption.read-out", null, "Pairs of a safe and an unsafe solution"),
    h("thead", null, h("tr", null, ["Pair", "Change, and what happened", "Evidence"].map((name) => h("th", { scope: "col" }, name)), h("th.right.wide-only", { scope: "col" }, "Apart"))),
    body));

  function row(pair, computed) {
    return h("tr", null,
      h("th", { scope: "row" }, h("a.row", { href: pairLink(id, pair, asked()), "aria-label": `Pair ${pair.place}: ${pair.change}` }, `Pair ${pair.place}`)),
      h("td.change", null, h("div", null, capital(pair.change)), pair.moved && h("div.small", null, `${capital(pair.moved)}.`), pair.common && h("div.small.muted", null, `In both: ${pair.common}`), ["unsafe", "safe"].map((side) => outcome(pair, side))),
      h("td", null, evidence(pair, computed), findings(pair).map((words) => h("div.small", null, words))),
      h("td.right.wide-only", null, figure(pair.distance)));
  }

  function outcome(pair, side) {
    const again = pair.confirmation[side];
    return h("div.small", null, outcomeBadge(pair[side]), again.evaluated > 0 && h("span.muted", null, ` unsafe with other seeds in ${share(again)}`));
  }

  node.update = (read) => {
    node.hidden = read.pairs.length === 0;
    keyed(body, read.pairs, (pair) => JSON.stringify([pair.place, pair.safe.number, pair.unsafe.number, pair.words, pair.confirmation, pair.component, pair.minimality, pair.checked]), (pair) => row(pair, read.computed));
  };
  return node;
}
