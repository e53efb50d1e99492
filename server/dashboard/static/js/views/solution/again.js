/** A solution simulated again with other seeds: how likely is it unsafe itself? */

import { isOpen } from "../../api.js";
import { h, replace, text } from "../../dom.js";
import { count, percent, plural } from "../../format.js";
import { link } from "../../router.js";
import { badge } from "../../parts/elements.js";

const USUAL = 20;
const MOST = 10_000;
const NO_GENERATION = 1_000_000_000;

/** Return the card that asks for repeats of a solution, and shows what came of them. */
export function again(context, campaign, number) {
  const said = h("div", { "aria-live": "polite" });
  const rows = h("tbody");
  const table = h("div.scroll", { tabindex: 0, role: "region", "aria-label": "Table of repeats", hidden: true }, h("table", null,
    h("caption", null, "Each line is a campaign that simulates this solution with seeds of its own."),
    h("thead", null, h("tr", null, ["Campaign", "State", "Simulated", "Unsafe", "Share", "Interval"].map((name, index) => h(index > 1 ? "th.right" : "th", { scope: "col" }, name)))),
    rows));
  const wanted = h("input", { id: "again", type: "number", min: 2, max: MOST, step: 1, value: USUAL, required: true });
  const go = h("button.primary", { type: "submit" }, "Simulate");
  const form = h("form.inline", { onsubmit: ask }, h("label", { for: "again" }, "Simulate it again with other seeds,"), wanted, h("span", null, "times"), go);
  const place = h("div");
  const card = h("section.card", { "aria-label": "With other seeds" }, h("h2", null, "With other seeds"),
    h("p", null, "This solution was simulated once. How likely it is unsafe itself is known only by simulating it again: other pedestrians, other noise."),
    place, said, table);

  async function ask(event) {
    event.preventDefault();
    go.disabled = true;
    const repeats = Number(wanted.value);
    const answer = await context.act("POST", `campaigns/${campaign.id}/repeats`, null, { json: { numbers: [number], repeats } });
    go.disabled = false;
    if (answer) polling.now();
  }

  function take(read) {
    const found = read.map((one) => ({ ...one, it: one.solutions.find((solution) => solution.number === number) })).filter((one) => one.it).reverse();
    table.hidden = found.length === 0;
    replace(rows, found.map(({ it, ...one }) => h("tr", null,
      h("td", null, h("a", { href: link("campaigns", one.campaign) }, one.boundary ? "with the whole boundary" : one.solutions.length > 1 ? `with ${one.solutions.length - 1} others` : "alone")),
      h("td", null, badge(one.status)),
      h("td.right", null, `${count(it.evaluated)} of ${count(one.repeats)}`), h("td.right", null, count(it.unsafe)),
      h("td.right", null, it.evaluated ? percent(it.probability) : "–"),
      h("td.right", null, it.evaluated ? `${percent(it.low)} to ${percent(it.high)}` : "–"))));
    const [latest] = found;
    text(said, latest ? sentence(latest) : "");
  }

  function offer(status) {
    if (!context.may.steer || place.firstChild === form) return;
    replace(place, isOpen(status) ? h("p.hint", null, `It can be simulated again once its campaign has ended; it is ${status} now.`) : form);
  }

  offer(campaign.status);
  if (context.may.steer && isOpen(campaign.status)) {
    const ended = new AbortController();
    context.watch(`campaigns/${campaign.id}/progress?since=${NO_GENERATION}`, (read) => {
      offer(read.status);
      if (!isOpen(read.status)) ended.abort();
    }, { refuse: () => {}, until: ended.signal });
  }
  const polling = context.watch(`campaigns/${campaign.id}/repeats`, take, {
    busy: (read) => read.some((one) => one.status === "running"), refuse: () => {},
  });
  return card;
}

function sentence({ it, repeats, p_th, status }) {
  if (!it.evaluated) return status === "running" ? "Workers simulate it now." : "Nothing came of it yet.";
  const so = it.evaluated < repeats ? " so far" : "";
  const side = it.low > p_th ? "below" : it.high < p_th ? "above" : "within";
  return `${count(it.unsafe)} of ${plural(it.evaluated, "simulation")} with other seeds ${it.unsafe === 1 ? "was" : "were"} unsafe${so}: ${percent(it.probability)}, interval ${percent(it.low)} to ${percent(it.high)}; the boundary is at ${percent(p_th)}, ${side} this interval.`;
}
