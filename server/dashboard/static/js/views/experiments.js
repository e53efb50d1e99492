/** The list of experiments and their status. */

import { isOpen } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { count, toldApart, when } from "../format.js";
import { link } from "../router.js";
import { badge, meter } from "../parts/elements.js";

const PAGE = 20;

export async function show(main, context, { query }) {
  context.title("Experiments");
  const cursor = query.get("cursor");
  const body = h("tbody");
  const table = h("div.card.scroll", { tabindex: 0, role: "region", "aria-label": "Experiments", hidden: true }, h("table.experiments", null,
    h("caption.read-out", null, "Experiments, newest first"),
    h("thead", null, h("tr", null, ["Experiment", "Status", "Campaigns finished", "Simulations", "Failed", "Submitted"].map((words) =>
      h("th", { scope: "col" }, words)))), body));
  const empty = h("div.empty", { hidden: true }, h("h2", null, "No experiments yet"),
    h("p", null, "An experiment runs every algorithm on every problem with every seed, and compares the results. Submit one from a file:"),
    h("p", null, h("code", null, `brink experiment submit FILE --server ${new URL(".", document.baseURI).href.replace(/\/$/, "")}`)));
  const newest = h("a.button", { href: link("experiments"), hidden: !cursor }, "Newest");
  const older = h("a.button", { hidden: true }, "Older");
  replace(main, h("div.head", null, h("h1", null, "Experiments")), table, empty, h("div.inline.pages", null, newest, older));

  const asked = new URLSearchParams({ limit: PAGE, ...(cursor ? { cursor } : {}) });
  context.watch(`experiments?${asked}`, (read) => {
    keyed(body, toldApart(read.experiments), (one) => one.id, experimentRow);
    table.hidden = read.experiments.length === 0;
    empty.hidden = read.experiments.length > 0;
    older.hidden = !read.next;
    attribute(older, "href", read.next && link("experiments", { cursor: read.next }));
  }, { busy: (read) => read.experiments.some((one) => one.status === "running") });
}

function experimentRow(first) {
  const state = badge(first.status);
  const finished = h("td");
  const done = meter(`Simulations of ${first.name}`);
  const numbers = h("span.small");
  const failed = h("td");
  const alike = h("code.alike");
  const node = h("tr", null, h("th", { scope: "row" }, h("a.row", { href: link("experiments", first.id) }, first.name), " ", alike), h("td", null, state), finished,
    h("td.progress", null, done, numbers), failed, h("td.small", null, when(first.created_at)));
  node.update = (one) => {
    text(alike, one.alike);
    state.update(one.status);
    text(finished, `${count(one.finished)} of ${count(one.campaigns)}${one.deleted ? `, ${count(one.deleted)} deleted` : ""}`);
    done.update(one.budget ? one.simulations / one.budget : 0, !isOpen(one.status));
    text(numbers, `${count(one.simulations)} of ${count(one.budget)}`);
    text(failed, count(one.failed));
  };
  node.update(first);
  return node;
}
