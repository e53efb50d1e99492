/** What is known of a pair, as badges and sentences. */

import { h } from "../../dom.js";
import { capital, count, figure, percent, sentence } from "../../format.js";
import { badge } from "../../parts/elements.js";

const STATES = { confirmed: "confirmed", "not confirmed": "not-confirmed", "too few drives": "found", "not tried": "found" };

/** Return a badge of how well a pair is established. */
export function evidence(pair, computed) {
  if (computed) return badge("confirmed", "computed");
  const { state } = pair.confirmation;
  if (state === "confirmed" || state === "not confirmed") return badge(STATES[state], state);
  return pair.checked ? badge("checked") : badge("found", "found once");
}

/** Return what the badge means, in a sentence. */
export function evidenceWords(pair, computed) {
  if (computed) return "Verdicts of this problem are computed, so both sides always keep theirs.";
  const { state } = pair.confirmation;
  if (state === "confirmed") return "Confirmed: with other seeds, the safe side stays safe and the unsafe side unsafe.";
  if (state === "not confirmed") return "Not confirmed: with other seeds, a side does not keep its verdict.";
  const search = pair.checked ? "Checked: both sides kept their verdicts in a further simulation of the search." : "Found once: each side was simulated once.";
  return state === "too few drives" ? `${search} There are too few simulations with other seeds to confirm it.` : `${search} Not simulated again with other seeds.`;
}

const COMPONENT = {
  component: "With ground truth in place of the component, the unsafe drive is safe: the hazard is the component's.",
  scenario: "With ground truth in place of the component, the unsafe drive is unsafe, too: the scenario alone is to blame.",
  failed: "The unsafe drive has no verdict with ground truth in place of the component.",
  pending: "The unsafe drive is being simulated with ground truth in place of the component.",
};
const MINIMALITY = {
  minimal: "Minimal: no difference can be taken back without losing the opposite verdicts.",
  "not minimal": "Not minimal: some of the differences can be taken back without losing the opposite verdicts.",
  undecided: "Whether every difference matters is undecided: some simulations failed.",
  pending: "Differences are being taken back one by one.",
};

/** Return sentences about the component's part and whether every difference matters; empty where that was not tried. */
export function findings(pair) {
  return [COMPONENT[pair.component.state], MINIMALITY[pair.minimality.state]].filter(Boolean);
}

/** Return the unsafe share of a side with its interval: ``0 of 10: 0%, 0% to 28%``; a dash if it was not tried. */
export function share({ evaluated, unsafe, probability, low, high }) {
  return evaluated ? `${count(unsafe)} of ${count(evaluated)}: ${percent(probability)}, ${percent(low)} to ${percent(high)}` : "–";
}

/** Return the table of a pair's differences. */
export function differences(pair) {
  const several = pair.changes.some(({ names }) => names.length > 1) || pair.changes.length > 1;
  return h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of differences" }, h("table.differences", null,
    h("caption", null, `${several ? "Parameters" : "The parameter"} in which the two differ, ${figure(pair.distance)} apart.`),
    h("thead", null, h("tr", null, ["Parameter", "Safe", "Unsafe", "Had a part"].map((name) => h("th", { scope: "col" }, name)))),
    h("tbody", null, pair.changes.map((change) => h("tr", { class: change.active === false ? "muted" : null },
      h("th", { scope: "row" }, change.names.map((name) => h("div", null, name.replaceAll("_", " ").replaceAll(".", " ")))),
      ["safe", "unsafe"].map((side) => h("td", null, change[side].map((value, place) => h("div", null, `${written(value)} ${change.units[place] ?? ""}`.trim())))),
      h("td", null, change.active === null ? "not recorded" : change.active ? "yes" : "no"))))));
}

function written(value) {
  return typeof value === "number" ? figure(value, 4) : String(value).replaceAll("_", " ");
}

/** Return words as a sentence that begins with a capital letter. */
export function said(words) {
  return sentence(capital(words));
}
