/** What searches of other kinds find: types of violations, chains of techniques; and whether the boundary holds up. */

import { h, replace } from "../../dom.js";
import { count, percent, plural } from "../../format.js";
import { sparing } from "../../sparing.js";
import { badge } from "../../parts/badge.js";
import { link } from "../../router.js";

const MOST = 12;

/**
 * Return the cards in one element; ``news(sequence)`` loads what is new.
 *
 * @param {Context} context
 * @param {string} id The campaign.
 * @param {string[]} tells What its problem tells: ``violations``, ``combinations``.
 */
export function findings(context, id, tells) {
  const violations = h("section.card", { hidden: true, "aria-label": "Violations" });
  const combinations = h("section.card", { hidden: true, "aria-label": "Combinations of techniques" });
  const repeats = h("section.card", { hidden: true, "aria-label": "Repeats" });
  const node = h("div.stack", { hidden: true }, violations, combinations, repeats);

  let told = "";
  let later = null;

  const load = sparing(async () => {
    const [broken, chains, again] = await Promise.all([optional("violations", "?types_only=true"), optional("combinations"), context.get(`campaigns/${id}/repeats`)]);
    if (broken) showViolations(broken);
    if (chains) showCombinations(chains);
    showRepeats(again);
    clearTimeout(later);
    // They run in campaigns of their own, whose news are not this one's.
    if (again.some((one) => one.status === "running")) later = setTimeout(() => load(`${told} ${performance.now()}`), 5_000);
    node.hidden = [...node.children].every((card) => card.hidden);
  }, { signal: context.signal, refuse: context.complain, leastMs: 10_000, share: 0.05 });

  async function optional(part, query = "") {
    return tells.includes(part) ? context.get(`campaigns/${id}/${part}${query}`) : null;
  }

  function showViolations(read) {
    violations.hidden = read.types.length === 0;
    const types = [...read.types].sort((a, b) => b.solutions - a.solutions);
    replace(violations, h("h2", null, "Types of violations"),
      h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Types of violations" },
        h("table", null, h("caption", null, `${plural(read.types.length, "type")} by the rules, the commonest first`),
          head("Type", "Solutions", "Distinct", "Fault", "First"),
          h("tbody", null, types.map((one) => h("tr", null, h("th", { scope: "row" }, one.type),
            h("td", null, count(one.solutions)), h("td", null, count(one.instances)),
            h("td", null, one.at_fault === null ? "differs" : one.at_fault ? "the car's" : "the others'"),
            h("td", null, solution(one.first))))))));
  }

  function showCombinations(read) {
    const telling = read.combinations.filter((one) => one.hazardous).slice(0, MOST);
    combinations.hidden = read.combinations.length === 0;
    replace(combinations, h("h2", null, "Combinations of techniques"),
      h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Combinations of techniques" },
        h("table", null, h("caption", null, telling.length ? "Hazardous ones: unsafe in at least four places of five" : "None is hazardous so far"),
          head("Techniques, in order", "Unsafe", "Their parts", "What it says"),
          h("tbody", null, telling.map((one) => h("tr", null, h("th", { scope: "row" }, one.words),
            h("td", null, `${one.unsafe} of ${one.trials}`),
            h("td.small", null, one.parts.map((each) => h("div", null, `${each.words || "nothing"}: ${each.unsafe} of ${each.trials}`))),
            h("td", null, [one.only_together && "only together", one.order_matters && "the order matters", one.minimal && "no part is hazardous"].filter(Boolean).join(", ") || "–",
              (one.together[0] ?? one.turned[0]) !== undefined && [" ", solution(one.together[0] ?? one.turned[0])])))))),
      alone(read.steps));
  }

  function alone(steps) {
    return h("details", null, h("summary", null, "Each technique alone, and with others"),
      h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Each technique alone" },
        h("table", null, h("caption.read-out", null, "Each technique alone, and with others"), head("Technique", "Alone", "With others"), h("tbody", null, steps.map((one) => h("tr", null,
          h("th", { scope: "row" }, one.words), h("td", null, `${one.alone_unsafe} of ${one.alone_trials}`), h("td", null, `${one.joined_unsafe} of ${one.joined_trials}`)))))));
  }

  function showRepeats(read) {
    repeats.hidden = read.length === 0;
    replace(repeats, h("h2", null, "Does it hold up? The same again with other seeds"), read.map((one) => h("div.repeat", null,
      h("p", null, h("a", { href: link("campaigns", one.campaign) }, which(one)), " ", badge(one.status)), h("p", null, came(one)))));
  }

  function which(one) {
    const what = one.boundary ? plural(one.solutions.length, "boundary solution") : one.solutions.length === 1 ? `solution ${one.solutions[0].number}` : plural(one.solutions.length, "named solution");
    return `${what}, ${one.solutions.length === 1 ? "" : "each "}${count(one.repeats)} times`;
  }

  function came(one) {
    if (one.evaluated === 0) return "No verdict yet.";
    const share = `${count(one.unsafe)} of ${count(one.evaluated)} simulations were unsafe, ${percent(one.unsafe / one.evaluated)}.`;
    return one.boundary ? `${count(one.holding)} of ${count(one.solutions.length)} have an interval that contains p_th ${percent(one.p_th)}; ${count(one.below)} are safer than that, ${count(one.above)} less safe. ${share}` : share;
  }

  function solution(number) {
    return h("a", { href: link("campaigns", id, "solutions", number) }, `solution ${number}`);
  }

  context.signal.addEventListener("abort", () => clearTimeout(later), { once: true });
  node.news = (sequence) => {
    if (sequence === told) return;
    told = sequence;
    load(sequence);
  };
  return node;
}

function head(...names) {
  return h("thead", null, h("tr", null, names.map((name) => h("th", { scope: "col" }, name))));
}
