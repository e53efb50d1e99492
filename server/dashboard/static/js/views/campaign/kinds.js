/** Findings of any kind as cards: sentences, tables, what the words mean, and what only one kind has. */

import { download } from "../../api.js";
import { h, keyed, replace, text } from "../../dom.js";
import { sentence } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { tableOf } from "../../parts/tables.js";
import { IN_CARD } from "./pictures.js";

const FEW = 10;
const MOST = 1_000;

/**
 * Return the cards in one element; ``update`` takes what the campaign found, ``refresh`` asks again where settings have changed.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {Record<string, () => object>} settings What to ask of a kind, by kind; empty for its defaults.
 * @param {(finding: object) => void} shown Called with each finding that a card shows.
 */
export function kindCards(context, id, settings, shown) {
  const node = h("div.stack");
  let read = null;

  const asked = (kind) => settings[kind]?.() ?? {};
  const isAsked = (kind) => Object.keys(asked(kind)).length > 0;

  node.update = (next) => {
    read = next;
    const told = new Set([next.words, next.headline, ...next.more]);
    const listed = next.findings.filter((one) => !one.is_empty || one.page || isAsked(one.kind));
    keyed(node, listed.map((finding) => ({ finding, told })), ({ finding }) => finding.kind,
      ({ finding }) => kindCard(context, id, finding, { told, asked: () => asked(finding.kind), shown }));
  };
  node.refresh = () => read && node.update(read);
  return node;
}

function kindCard(context, id, first, { told, asked, shown }) {
  const words = h("p");
  const more = h("div");
  const tables = h("div.stack");
  const legend = h("ul.plain.hint");
  const reading = h("details", null, h("summary.hint", null, "How to read it"), legend);
  const part = IN_CARD[first.kind]?.(context, id);
  const open = h("a.button", null, `Open ${first.title.toLowerCase()}`);
  const node = h("section.card.kind", { "aria-label": first.title },
    h("div.inline", null, h("h2", null, first.title), h("div.actions.push", null, open)),
    words, more, part?.above, tables, reading, part?.below);
  let rows = FEW; // more, once the reader has asked
  let loaded = "";

  /** Ask for other settings, or for all rows, than those of the list of findings. */
  const load = loadOnNews(async () => {
    const wanted = String(query({ rows }));
    const read = await context.get(`campaigns/${id}/findings/${encodeURIComponent(first.kind)}?${wanted}`);
    if (wanted === String(query({ rows }))) draw(read); // otherwise the settings have changed meanwhile
  }, { signal: context.signal, refuse: context.complain, leastMs: 2_000, share: 0.05 });

  function query(more) {
    return new URLSearchParams({ ...asked(), ...more });
  }

  function draw(finding) {
    const known = (said) => told.has(sentence(said));
    text(words, sentence(finding.sentence));
    words.hidden = known(finding.sentence);
    replace(more, [...finding.more, ...finding.caveats].filter((said) => !known(said)).map((said) => h("p.hint", null, sentence(said))));
    keyed(tables, finding.tables.filter((table) => table.rows.length), (table) => table.name, (table) => savedTable(finding.kind, table));
    replace(legend, finding.legend.map((said) => h("li", null, sentence(said))));
    reading.hidden = finding.legend.length === 0;
    open.hidden = !finding.page;
    open.href = `#/${finding.page}`;
    part?.update(finding);
    shown(finding);
  }

  function savedTable(kind, first) {
    const shownTable = tableOf(id, { complete: () => { rows = MOST; load(`all ${query({})}`, { atOnce: true }); } });
    let latest = first;
    const save = (form, label) => h("button.quiet", { type: "button", onclick: () => context.tell(() => download(place(form), `${latest.name}-${id}.${form}`)) }, label);

    function place(form) {
      if (latest.file) return `campaigns/${id}/${latest.file}&format=${form}`;
      return `campaigns/${id}/findings/${encodeURIComponent(kind)}?${query({ table: latest.name, format: form })}`;
    }

    const made = h("div", null, shownTable, h("p", null, save("csv", "CSV"), save("jsonl", "JSON Lines")));
    made.update = (table) => {
      latest = table;
      shownTable.update(table);
    };
    made.update(first);
    return made;
  }

  node.update = ({ finding, told: now }) => {
    told = now;
    const settings = String(query({}));
    const atOnce = settings !== loaded;
    loaded = settings;
    if (rows === FEW && !settings) draw(finding);
    else load(`${settings} ${JSON.stringify([finding.sentence, finding.tables])}`, { atOnce });
  };
  node.update({ finding: first, told });
  return node;
}
