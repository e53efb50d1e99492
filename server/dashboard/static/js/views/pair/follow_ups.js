/** The card that asks more about the pairs of a campaign: do they hold, is the component to blame, which differences matter? */

import { isOpen } from "../../api.js";
import { attribute, h, keyed, text } from "../../dom.js";
import { count, plural } from "../../format.js";
import { link } from "../../router.js";
import { badge, meter } from "../../parts/elements.js";
import { said } from "./words.js";

const USUAL_REPEATS = 30;
const MOST_REPEATS = 10_000;

const QUESTIONS = {
  confirm: { title: "Do they hold?", go: "Confirm", what: "Simulates both sides of each pair with other seeds, until it is confirmed or refuted that each keeps its verdict." },
  component: { title: "Is the component to blame?", go: "Ask", what: "Simulates each unsafe side once more, in the same episode, with ground truth in place of the component." },
  minimise: { title: "Which differences matter?", go: "Minimise", what: "Reverts the differences of each pair one by one, in the unsafe side's episode, as long as it stays unsafe." },
};

/**
 * Return the card; ``update`` takes the pairs of the campaign.
 *
 * @param {Context} context
 * @param {string} id Campaign.
 * @param {() => {eps: number|null, d_th: number|null}} asked What counts as a pair.
 * @param {() => void} news Called when something has been requested.
 */
export function followUps(context, id, asked, news) {
  const repeats = h("input", { id: "confirmations", type: "number", min: 2, max: MOST_REPEATS, step: 1, value: USUAL_REPEATS, required: true, oninput: () => last && update(last) });
  const rows = Object.keys(QUESTIONS).map((kind) => question(kind));
  const card = h("section.card", { "aria-label": "Ask more about these pairs", hidden: true }, h("h2", null, "Ask more about these pairs"),
    h("p.hint", null, "Each question is simulated as a campaign of its own; the pairs above follow it."), rows.map(({ node }) => node));
  let last = null;

  function question(kind) {
    const { title, go, what } = QUESTIONS[kind];
    const cost = h("span.small.muted", { id: `cost-${kind}` });
    const button = h("button", { type: "submit", "aria-describedby": `cost-${kind}` }, go);
    const form = context.may.steer && h("form.inline", { onsubmit: (event) => { event.preventDefault(); ask(kind, button); } },
      kind === "confirm" && [h("label", { for: "confirmations" }, "Most simulations of each side"), repeats], button, cost);
    const told = h("div");
    const node = h("div.question", { role: "group", "aria-label": title }, h("h3", null, title), h("p", null, what), form || null, told);
    return { kind, node, button, cost, told };
  }

  async function ask(kind, button) {
    button.disabled = true;
    const body = { kind, ...(kind === "confirm" ? { repeats: Number(repeats.value) } : {}) };
    for (const [name, value] of Object.entries(asked())) if (value !== null) body[name] = value;
    const answer = await context.act("POST", `campaigns/${id}/pairs/follow-ups`, null, { json: body });
    button.disabled = false;
    if (answer) news();
  }

  function update(read) {
    last = read;
    card.hidden = read.evaluated === 0 || (read.complete && read.pairs.length === 0);
    for (const { kind, button, cost, told } of rows) {
      const offer = read.offers.find((one) => one.kind === kind);
      attribute(button, "disabled", offer.reason ? "" : null);
      text(cost, offer.reason ? said(offer.reason) : costWords(offer, Number(repeats.value)));
      keyed(told, read.follow_ups.filter((one) => one.kind === kind).reverse(), (one) => `${one.campaign} ${one.status}`, follower);
    }
  }

  card.update = update;
  return card;
}

function costWords({ kind, simulations, left_out }, repeats) {
  const others = left_out ? ` Leaves out ${plural(left_out, "pair")} with different seeds on the two sides.` : "";
  if (kind === "component") return `${plural(simulations, "simulation")}.`;
  return `At most ${plural(kind === "confirm" ? simulations * repeats : simulations, "simulation")}.${others}`;
}

/** Return one line about a follow-up: its status and, while it is open, how far it is. */
export function follower(one) {
  const words = h("span.small");
  const bar = isOpen(one.status) ? meter("Simulations done") : null;
  const node = h("div.follow-up", null, h("div.inline", null, badge(one.status), words, h("a.small", { href: link("campaigns", one.campaign) }, "Campaign")), bar);
  node.update = (next) => {
    const done = next.status === "finished" ? plural(next.simulations, "simulation") : `${count(next.simulations)} of ${plural(next.budget, "simulation")}`;
    text(words, next.status_reason ? `${done}: ${next.status_reason}` : done);
    bar?.update(next.budget ? next.simulations / next.budget : 0);
  };
  node.update(one);
  return node;
}
