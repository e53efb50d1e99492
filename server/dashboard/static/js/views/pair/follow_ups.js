/** The card that asks more about the pairs of a campaign: one question for each kind of follow-up that the server offers. */

import { isOpen } from "../../api.js";
import { attribute, h, keyed, text } from "../../dom.js";
import { count, plural } from "../../format.js";
import { link } from "../../router.js";
import { badge, meter } from "../../parts/elements.js";
import { said } from "./words.js";

const MOST_REPEATS = 10_000;

/**
 * Return the card; ``update`` takes the pairs of the campaign.
 *
 * @param {Context} context
 * @param {string} id Campaign.
 * @param {() => {eps: number|null, d_th: number|null}} asked What counts as a pair.
 * @param {() => void} news Called when something has been requested.
 */
export function followUps(context, id, asked, news) {
  const questions = h("div");
  const card = h("section.card", { "aria-label": "Ask more about these pairs", hidden: true }, h("h2", null, "Ask more about these pairs"),
    h("p.hint", null, "Each question is simulated as a campaign of its own; the pairs above follow it."), questions);

  function question({ kind, title, label, words, repeats: usual }) {
    const repeats = usual && h("input", { id: `repeats-${kind}`, type: "number", min: 2, max: MOST_REPEATS, step: 1, value: usual, required: true, oninput: () => tell() });
    const cost = h("span.small.muted", { id: `cost-${kind}` });
    const button = h("button", { type: "submit", "aria-describedby": `cost-${kind}` }, label);
    const form = context.may.steer && h("form.inline", { onsubmit: (event) => { event.preventDefault(); ask({ kind, ...(repeats ? { repeats: Number(repeats.value) } : {}) }, button); } },
      repeats && [h("label", { for: `repeats-${kind}` }, "Most simulations of each side"), repeats], button, cost);
    const told = h("div");
    const node = h("div.question", { role: "group", "aria-label": title }, h("h3", null, title), h("p", null, words), form || null, told);
    let offer = null;

    function tell() {
      attribute(button, "disabled", offer.reason ? "" : null);
      text(cost, offer.reason ? said(offer.reason) : costWords(offer, repeats ? Number(repeats.value) : 1));
    }

    node.update = ([next, followUps]) => {
      offer = next;
      tell();
      keyed(told, followUps, (one) => `${one.campaign} ${one.status}`, follower);
    };
    return node;
  }

  async function ask(body, button) {
    button.disabled = true;
    for (const [name, value] of Object.entries(asked())) if (value !== null) body[name] = value;
    const answer = await context.act("POST", `campaigns/${id}/pairs/follow-ups`, null, { json: body });
    button.disabled = false;
    if (answer) news();
  }

  card.update = (read) => {
    card.hidden = read.evaluated === 0 || (read.complete && read.pairs.length === 0);
    const rows = read.offers.map((offer) => [offer, read.follow_ups.filter((one) => one.kind === offer.kind).reverse()]);
    keyed(questions, rows, ([{ kind }]) => kind, updated);
  };

  function updated(row) {
    const node = question(row[0]);
    node.update(row);
    return node;
  }
  return card;
}

function costWords({ exact, simulations, left_out }, repeats) {
  const others = left_out ? ` Leaves out ${plural(left_out, "pair")} with different seeds on the two sides.` : "";
  return `${exact ? "" : "At most "}${plural(simulations * repeats, "simulation")}.${others}`;
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
