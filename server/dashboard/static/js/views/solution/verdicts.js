/** What each requirement says of a solution. */

import { h } from "../../dom.js";
import { figure, plainId, spaced } from "../../format.js";
import { badge } from "../../parts/elements.js";
import { seconds } from "./controls.js";

/** Return the requirement that a solution was judged by: what the campaign names, or else whose robustness it has. */
export function judgedBy(solution, campaign) {
  const verdicts = Object.entries(solution.verdicts ?? {});
  const wanted = campaign.body.problem.params.requirement;
  const found = verdicts.find(([name]) => name === wanted) ?? verdicts.find(([, one]) => one.robustness === solution.robustness);
  return found?.[0] ?? null;
}

/** Return a robustness with its unit: ``−0.5 m``. */
export function withUnit(robustness, unit) {
  return `${figure(robustness)}${unit ? ` ${unit}` : ""}`;
}

/**
 * Return the card of a solution's verdicts; null if it has none.
 *
 * @param {object} solution
 * @param {string|null} judged The requirement that decides.
 * @param {(time_s: number) => void} goTo Shows a time of the episode.
 */
export function verdicts(solution, judged, goTo) {
  const told = Object.entries(solution.verdicts ?? {});
  if (told.length === 0) return null;
  told.sort(([a], [b]) => (b === judged) - (a === judged));
  return h("section.card", { "aria-label": "Verdicts" }, h("h2", null, "Verdicts"), h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of verdicts" }, h("table.verdicts", null,
    h("caption", null, "Robustness is the distance to violation; below zero the requirement is violated."),
    h("thead", null, h("tr", null, ["Requirement", "Verdict"].map((name) => h("th", { scope: "col" }, name)),
      h("th.right", { scope: "col" }, "Robustness"), h("th.right", { scope: "col" }, "Violated"))),
    h("tbody", null, told.map(([name, one]) => {
      const violated = one.robustness < 0;
      const at = one.violated_at_s;
      return h("tr", { class: name === judged ? "chosen" : null },
        h("th", { scope: "row" }, spaced(plainId(name)), name === judged && h("span.small.muted", null, ", decides")),
        h("td", null, badge(violated ? "unsafe" : "safe", violated ? "violated" : "holds")),
        h("td.right", null, withUnit(one.robustness, one.unit)),
        h("td.right", null, at === null ? "–" : h("button.quiet.figure", { type: "button", onclick: () => goTo(at) }, `at ${seconds(at)}`)));
    })))));
}
