/** The evidence for a pair, as badges and sentences. */

import { h } from "../../dom.js";
import { capital, count, figure, percent, plural, sentence } from "../../format.js";
import { link } from "../../router.js";
import { badge } from "../../parts/elements.js";

const STATES = { confirmed: "confirmed", refuted: "refuted", undecided: "undecided" };

/** Return a badge of how well a pair is established. */
export function evidence(pair, computed) {
  if (computed) return badge("confirmed", "computed");
  const { state } = pair.confirmation;
  if (STATES[state]) return badge(STATES[state], state);
  return pair.checked ? badge("checked") : badge("found", "found once");
}

/** Return what the badge means, in a sentence; ``rule`` says when a pair is confirmed. */
export function evidenceWords(pair, { computed, rule }) {
  if (computed) return "Verdicts of this problem are computed, so both sides always keep theirs.";
  const { state } = pair.confirmation;
  const wrong = `The error rate of this claim is ${percent(rule.error)}.`;
  if (state === "confirmed") return `Confirmed: with other seeds, the safe side is unsafe with a probability of at most ${percent(rule.safe_at_most)}, and the unsafe side with one of at least ${percent(rule.unsafe_at_least)}. ${wrong}`;
  if (state === "refuted") return `Refuted: with other seeds, the safe side is unsafe with a probability of more than ${percent(rule.safe_at_most)}, or the unsafe side with one of less than ${percent(rule.unsafe_at_least)}. ${wrong}`;
  if (state === "undecided") return `Undecided: the simulations with other seeds neither confirm nor refute it. It takes ${count(rule.least_drives)} of each side to confirm a pair, and ${count(rule.further_drives)} more for each with the other verdict.`;
  const search = pair.checked ? "Checked: both sides kept their verdicts with another seed in the search." : "Found once: each side was simulated once.";
  if (state === "pending") return `${search} Both sides are being simulated again with other seeds.`;
  return `${search} Not simulated again with other seeds.`;
}

const COMPONENT = {
  component: ({ outcome }) => `With ground truth in place of the component, the unsafe drive: ${outcome}. The hazard is the component's, judged with this one seed.`,
  scenario: ({ outcome }) => `With ground truth in place of the component, the unsafe drive: ${outcome}. The scenario alone is to blame, judged with this one seed.`,
  failed: () => "The unsafe drive has no verdict with ground truth in place of the component.",
  pending: () => "The unsafe drive is being simulated with ground truth in place of the component.",
};
const PARTS = { component: "component's hazard (one seed)", scenario: "scenario's hazard (one seed)" };

/** Return short words for a list: whose hazard it is, and how many differences matter; empty where that was not tried. */
export function findings(pair) {
  return [PARTS[pair.component.state], lessWords(pair)].filter(Boolean);
}

function lessWords({ minimality, changes }) {
  if (minimality.unsafe) return `${count(minimality.unsafe.changes.length)} of ${plural(changes.length, "difference")} ${minimality.unsafe.changes.length === 1 ? "is" : "are"} enough`;
  return minimality.state === "minimal" ? "minimal" : "";
}

/** Return paragraphs about the component's part and the differences that matter; empty where that was not tried. */
export function findingsAtLength(pair) {
  const { component, minimality } = pair;
  const part = COMPONENT[component.state]?.(component);
  return [
    part && h("p", null, `${part} `, PARTS[component.state] && h("a", { href: link("campaigns", component.campaign, "solutions", component.number) }, "That drive")),
    minimalityAtLength(pair, minimality),
  ].filter(Boolean);
}

function minimalityAtLength(pair, { state, unsafe, campaign }) {
  if (unsafe) {
    return h("p", null, h("strong", null, `${unsafe.minimal ? "Minimal" : "Smaller"} change: `), `${lessWords(pair)}. `,
      unsafe.change === pair.change ? "In words, the change is the same. " : `${said(unsafe.change)} ${capital(unsafe.outcome)}. `,
      h("a", { href: link("campaigns", campaign, "solutions", unsafe.number) }, "That drive"));
  }
  if (state === "minimal") return h("p", null, "Minimal: no difference can be reverted without losing the opposite verdicts.");
  if (state === "different seeds") return h("p", null, "Not minimised: the two had different seeds, so chance may decide rather than a difference.");
  if (state === "undecided") return h("p", null, "Whether every difference matters is undecided: some simulations failed.");
  return state === "pending" ? h("p", null, "Differences are being reverted one by one.") : null;
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
    h("thead", null, h("tr", null, ["Parameter", "Safe", "Unsafe", "Moved, of its range", "Had a part"].map((name) => h("th", { scope: "col" }, name)))),
    h("tbody", null, pair.changes.map((change) => h("tr", { class: change.active === false ? "muted" : null },
      h("th", { scope: "row" }, change.titles.map((title) => h("div", null, title))),
      ["safe", "unsafe"].map((side) => h("td", null, change[side].map((value, place) => h("div", null, `${written(value)} ${change.units[place] ?? ""}`.trim())))),
      h("td.right", null, change.moved === null ? "another category" : percent(change.moved)),
      h("td", null, change.active === null ? "not recorded" : change.active ? "yes" : "no"))))));
}

function written(value) {
  return typeof value === "number" ? figure(value, 4) : String(value).replaceAll("_", " ");
}

/** Return words as a sentence that begins with a capital letter. */
export function said(words) {
  return sentence(capital(words));
}
