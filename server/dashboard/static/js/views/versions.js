/** The drives of a suite by versions: a row for each drive, a column for each campaign that simulated the suite, newest first. */

import { isOpen } from "../api.js";
import { h, replace, text } from "../dom.js";
import { sentence, when } from "../format.js";
import { link } from "../router.js";

export async function show(main, context, { parts }) {
  const campaign = await context.get(`campaigns/${encodeURIComponent(parts[1])}`);
  const { id, name } = campaign;
  context.title(`Versions, ${name}`);
  const words = h("p.lead", { "aria-live": "polite" });
  const table = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Drives by versions" });
  replace(main,
    h("p.crumb", null, h("a", { href: link("campaigns") }, "Campaigns"), " / ", h("a", { href: link("campaigns", id) }, name)),
    h("div.head", null, h("h1", null, "Versions")),
    h("div.stack", null, h("section.card", { "aria-label": "Versions" }, words, table,
      h("p.hint", null, "✓ safe, ✗ unsafe, ? unclear, ≠ not reproduced, ! cannot run, … not simulated yet, · not in that run. A frame: not as expected. The numbers are unsafe simulations; each leads to one with the verdict."))));

  let told = "";
  context.watch(`campaigns/${id}/suite/versions`, (read) => {
    if (JSON.stringify(read) === told) return; // keeps focus
    told = JSON.stringify(read);
    text(words, sentence(read.words));
    replace(table, drives(read));
  }, { busy: (read) => read.versions.some(({ status }) => isOpen(status)) });
}

function drives({ versions, rows }) {
  return h("table.versions", null, h("caption.read-out", null, "Drives by versions"),
    h("thead", null, h("tr", null, h("th", { scope: "col" }, "Drive"), versions.map((one) =>
      h("th", { scope: "col" }, h("a", { href: link("campaigns", one.campaign) }, one.label), h("div.small.muted", null, when(one.at)))))),
    h("tbody", null, rows.map((row) => h("tr", null,
      h("th", { scope: "row" }, row.name, row.turned_unsafe && h("div.small.trouble", null, "turned unsafe")),
      row.cells.map((cell, place) => cell === null ? h("td.none", null, "·") : h("td", { class: `${cell.state}${cell.fails ? " fails" : ""}`, title: cell.words },
        cell.mark, " ", cell.simulated && (cell.solution === null ? cell.simulated : h("a", { href: link("campaigns", versions[place].campaign, "solutions", cell.solution) }, cell.simulated)),
        h("span.read-out", null, ` ${cell.words}`)))))));
}
