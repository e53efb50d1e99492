/** The course of the search: boundary solutions over simulations at chosen thresholds, unsafe share, fitness. */

import { UNCHANGED, Conditional } from "../../api.js";
import { h, text } from "../../dom.js";
import { sparing } from "../../sparing.js";
import { chart } from "../../parts/chart.js";
import { rewrite } from "../../router.js";

/** Keeps the generations told so far; an answer brings those that are new. */
export class Generations {
  list = [];

  /** The number of the first generation that is not known. */
  get next() {
    return this.list.length ? this.list.at(-1).number + 1 : 0;
  }

  take(more) {
    for (const one of more) if (one.number >= this.next) this.list.push(one);
  }
}

/** Return the cards; ``news(progress, generations)`` draws what is new. */
export function courseCards(context, id, query) {
  const t_b = threshold("t-b", "t_b", query.get("t_b"), 0.1);
  const d_th = threshold("d-th", "d_th", query.get("d_th"), 0.2);
  const conditional = new Conditional();
  let defaults = { t_b: 0.1, d_th: 0.2 };
  let generations = null;

  const dbs = chart({
    label: "Distinct boundary solutions over simulations", x: "simulations", signal: context.signal, height: 400,
    series: [{ label: "DBS", colour: "--series-1" }, { label: "strict DBS", colour: "--series-1", dash: [6, 4] }],
    options: { scales: { x: { time: false }, y: { range: (_, __, most) => [0, Math.max(5, (most ?? 0) * 1.06)] } } },
  });
  const shares = chart({
    label: "Unsafe share over simulations", x: "simulations", signal: context.signal, height: 200,
    series: [{ label: "unsafe, %", colour: "--series-2" }],
  });
  const fitness = chart({
    label: "Fitness over generations", x: "generation", signal: context.signal, height: 200,
    series: [{ label: "best", colour: "--series-1" }, { label: "median", colour: "--series-6", dash: [6, 4] }],
  });
  const note = h("p.hint", { "aria-live": "polite" });
  const reset = h("button.quiet", { type: "button", onclick: () => set(defaults.t_b, defaults.d_th) }, "Defaults");
  const dbsCard = h("section.card", { "aria-label": "Boundary solutions over simulations" },
    h("div.inline", null, h("h2", null, "Distinct boundary solutions"), t_b.label, d_th.label, reset), dbs, note);
  const shareCard = h("section.card", null, h("h2", null, "Unsafe share"), shares);
  const fitnessCard = h("section.card", null, h("h2", null, "Fitness by generation"), fitness,
    h("p.hint", null, "Of what the algorithm minimises; 0 lies on the boundary for searches of a boundary."));

  for (const field of [t_b, d_th]) {
    field.input.addEventListener("change", () => {
      if (!field.input.reportValidity()) return;
      rewrite({ t_b: t_b.value() === defaults.t_b ? null : t_b.value(), d_th: d_th.value() === defaults.d_th ? null : d_th.value() });
      draw({ atOnce: true });
      context.thresholds?.();
    });
  }

  const load = sparing(async () => {
    const read = await conditional.get(`campaigns/${id}/course?t_b=${t_b.value()}&d_th=${d_th.value()}`, { signal: context.signal });
    if (read === UNCHANGED || isDefault()) return;
    dbs.update([[0, ...read.simulations], [0, ...read.dbs], [0, ...read.strict_dbs]]);
    text(note, read.note ?? explained());
  }, { signal: context.signal, refuse: context.complain, leastMs: 2_000 });

  function isDefault() {
    return t_b.value() === defaults.t_b && d_th.value() === defaults.d_th;
  }

  function set(wantedT, wantedD) {
    t_b.input.value = wantedT;
    d_th.input.value = wantedD;
    t_b.input.dispatchEvent(new Event("change"));
  }

  function explained() {
    const loose = t_b.value() >= 0.111;
    return `Fitness at most t_b, and at least d_th from each other. Strict: the interval holds p_th, and both verdicts occur around it.${
      loose ? " From t_b 0.111 on, surroundings without a single unsafe solution may count as boundary; strict ones never do." : ""}`;
  }

  function draw({ atOnce = false } = {}) {
    if (!generations) return;
    const list = generations.list;
    const told = list.map((one) => one.evaluated + one.measured + one.failed);
    if (isDefault()) {
      conditional.forget();
      dbs.update([[0, ...told], [0, ...list.map((one) => one.dbs)], [0, ...list.map((one) => one.strict_dbs)]]);
      text(note, explained());
    } else {
      load(`${generations.next} ${t_b.value()} ${d_th.value()}`, { atOnce });
    }
    shares.update([told, list.map((one) => (one.evaluated ? (100 * one.unsafe) / one.evaluated : null))]);
    fitness.update([list.map((one) => one.number), list.map((one) => one.best_fitness), list.map((one) => one.median_fitness)]);
  }

  return {
    dbs: dbsCard, shares: shareCard, fitness: fitnessCard,
    thresholds: () => ({ t_b: t_b.value(), d_th: d_th.value() }),
    news(progress, known) {
      defaults = { t_b: progress.t_b, d_th: progress.d_th };
      dbsCard.hidden = !progress.looks_for_boundary;
      if (generations !== known || known.next !== this.drawn) {
        generations = known;
        this.drawn = known.next;
        draw();
      }
    },
  };
}

function threshold(id, name, given, usual) {
  const known = Number(given);
  const input = h("input", {
    id, type: "number", min: 0, max: 1, step: 0.01, required: true,
    value: given !== null && Number.isFinite(known) && known >= 0 && known <= 1 ? known : usual,
  });
  let valid = Number(input.value);
  const value = () => {
    if (input.value !== "" && input.validity.valid) valid = Number(input.value);
    return valid; // of what is half written, the last that could be used
  };
  return { input, label: h("label", { for: id }, name, " ", input), value };
}
