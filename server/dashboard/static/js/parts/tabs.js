/** Tabs: parts of a view of which one is shown. The choice is kept in the address. */

import { attribute, h } from "../dom.js";
import { rewrite } from "../router.js";

/**
 * Return the tabs with their panels. A tab disappears while its panel has nothing to show.
 *
 * @param {string} label What they are parts of.
 * @param {URLSearchParams} query ``tab`` of the address.
 * @param {Record<string, [words: string, node: HTMLElement]>} parts The first is shown unless the address says otherwise.
 * @returns {HTMLElement} With ``panels``, by name, and ``settle()``, to be called when content has been moved.
 */
export function tabs(label, query, parts) {
  const [first] = Object.keys(parts);
  let shown = Object.hasOwn(parts, query.get("tab") ?? "") ? query.get("tab") : first;
  const list = h("div.tabs", { role: "tablist", "aria-label": label, onkeydown: move });
  const known = Object.entries(parts).map(([name, [words, node]]) => {
    const panel = h("div", { id: `panel-${name}`, role: "tabpanel", "aria-labelledby": `tab-${name}` }, node);
    const tab = h("button", { id: `tab-${name}`, type: "button", role: "tab", "aria-controls": panel.id, onclick: () => choose(name) }, words);
    list.append(tab);
    return { name, panel, tab };
  });
  const node = h("div.tabbed", null, list, known.map((one) => one.panel));

  function choose(name) {
    shown = name;
    rewrite({ tab: name === first ? null : name });
    update();
  }

  function update() {
    for (const { name, panel, tab } of known) {
      attribute(tab, "aria-selected", String(name === shown));
      attribute(tab, "tabindex", name === shown ? "0" : "-1");
      tab.hidden = !hasContent(panel) && name !== shown;
      if (panel.hidden === (name === shown)) panel.hidden = name !== shown; // setting it again would be a change, too
    }
  }

  /** Move along the tabs with the arrow keys, as people expect of them. */
  function move(event) {
    const seen = known.filter(({ tab }) => !tab.hidden);
    const at = seen.findIndex(({ name }) => name === shown);
    const to = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: seen.length - 1 }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    const next = seen[(to + seen.length) % seen.length];
    choose(next.name);
    next.tab.focus();
  }

  const changes = new MutationObserver(update);
  for (const { panel } of known) changes.observe(panel, { childList: true, subtree: true, attributes: true, attributeFilter: ["hidden"] });
  /** Show the first panel instead of one whose content has gone elsewhere. */
  node.settle = () => {
    if (!node.panels[shown].hasChildNodes()) choose(first);
  };
  node.panels = Object.fromEntries(known.map(({ name, panel }) => [name, panel]));
  update();
  return node;
}

/** Return whether anything in a panel is shown once the panel is. */
function hasContent(panel) {
  const isShown = (node) => !node.hidden && (node.matches(".card, p") || [...node.children].some(isShown));
  return [...panel.children].some(isShown);
}
