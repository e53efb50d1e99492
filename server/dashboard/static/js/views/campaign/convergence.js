/** Convergence of a search: boundary solutions against simulations at chosen thresholds, unsafe share, fitness. */

import { Conditional, UNCHANGED } from "../../api.js";
import { h, text } from "../../dom.js";
import { capital } from "../../format.js";
import { loadOnNews } from "../../polling.js";
import { rewrite } from "../../router.js";
import { chart } from "../../parts/charts.js";

/** The completed generations; each response brings new ones. */
export class Generations {
  list = [];

  /** Number of the first generation that is not known yet. */
  get next() {
    return this.list.length ? this.list.at(-1).number + 1 : 0;
  }

  take(more) {
    for (const one of more) if (one.number >= this.next) this.list.push(one);
  }
}

/** Return the cards in one element, which appears with the first generation; ``news(progress, generations)`` draws new data, ``chosen()`` returns the thresholds that are not the defaults. */
export function convergenceCards(context, id, query, thresholds) {
  const t_b = threshold("t-b", "t_b", query.get("t_b"), thresholds.t_b);
  const d_th = threshold("d-th", "d_th", query.get("d_th"), thresholds.d_th);
  const conditional = new Conditional();
  let defaults = thresholds;
  let generations = null;
  let unavailable = null; // why there is no curve at these thresholds
  let isEmpty = true; // whether there was never a boundary solution at these thresholds
  let finds = []; // the boundary may be a side line of the search, and there may be none

  const dbs = chart({
    label: "Distinct boundary solutions against the number of simulations", x: "simulations", signal: context.signal, height: 400,
    series: [{ label: "DBS", colour: "--series-1" }, { label: "strict DBS", colour: "--series-1", dash: [6, 4] }],
    options: { scales: { x: { time: false }, y: { range: (_, __, most) => [0, Math.max(5, (most ?? 0) * 1.06)] } } },
  });
  const shares = chart({
    label: "Unsafe share against the number of simulations", x: "simulations", signal: context.signal, height: 200,
    series: [{ label: "unsafe, %", colour: "--series-2" }],
  });
  const fitness = chart({
    label: "What the algorithm minimises, by generation", x: "generation", signal: context.signal, height: 200,
    series: [{ label: "best", colour: "--series-1" }, { label: "median", colour: "--series-6", dash: [6, 4] }],
  });
  const note = h("p.hint", { "aria-live": "polite" });
  const reset = h("button.quiet", { type: "button", onclick: () => set(defaults.t_b, defaults.d_th) }, "Defaults");
  const dbsCard = h("section.card", { "aria-label": "Boundary solutions against the number of simulations" },
    h("div.inline", null, h("h2", null, "Distinct boundary solutions"), t_b.label, d_th.label, reset), dbs, note);
  const shareCard = h("section.card", null, h("h2", null, "Unsafe share"), shares);
  const fitnessTitle = h("h2");
  const fitnessHint = h("p.hint");
  const fitnessCard = h("section.card", null, fitnessTitle, fitness, fitnessHint);
  const card = h("div.grid-wide", { hidden: true }, dbsCard, h("div.stack", null, shareCard, fitnessCard));

  for (const field of [t_b, d_th]) {
    field.input.addEventListener("change", () => {
      if (!field.input.reportValidity()) return;
      rewrite({ t_b: t_b.value() === defaults.t_b ? null : t_b.value(), d_th: d_th.value() === defaults.d_th ? null : d_th.value() });
      draw({ atOnce: true });
      context.thresholds?.();
    });
  }

  const load = loadOnNews(async () => {
    const read = await conditional.get(`campaigns/${id}/course?t_b=${t_b.value()}&d_th=${d_th.value()}`, { signal: context.signal });
    if (read === UNCHANGED || isCounted()) return;
    show(read.simulations, read.dbs, read.strict_dbs, read.note);
  }, { signal: context.signal, refuse: context.complain, leastMs: 2_000 });

  function isDefault() {
    return t_b.value() === defaults.t_b && d_th.value() === defaults.d_th;
  }

  /** Whether the boundary solutions of every generation were counted at these thresholds. */
  function isCounted() {
    return isDefault() && generations.list.every((one) => one.dbs !== null);
  }

  function show(simulations, distinct, strict, reason) {
    dbs.update([[0, ...simulations], [0, ...distinct], [0, ...strict]]);
    unavailable = reason;
    isEmpty = distinct.every((one) => one === 0);
    hide();
    explain();
  }

  function hide() {
    dbsCard.hidden = !finds.includes("boundary") || (finds[0] !== "boundary" && isDefault() && isEmpty);
  }

  function set(wantedT, wantedD) {
    t_b.input.value = wantedT;
    d_th.input.value = wantedD;
    t_b.input.dispatchEvent(new Event("change"));
  }

  function explain() {
    text(note, unavailable ?? `DBS counts solutions with a fitness of at most t_b that are at least d_th apart.`);
  }

  function draw({ atOnce = false } = {}) {
    if (!generations) return;
    const list = generations.list;
    const simulations = list.map((one) => one.evaluated + one.measured + one.failed);
    if (isCounted()) {
      conditional.forget();
      show(simulations, list.map((one) => one.dbs), list.map((one) => one.strict_dbs), null);
    } else if (finds.includes("boundary")) {
      load(`${generations.next} ${t_b.value()} ${d_th.value()}`, { atOnce });
    }
    shares.update([simulations, list.map((one) => (one.evaluated ? (100 * one.unsafe) / one.evaluated : null))]);
    fitness.update([list.map((one) => one.number), list.map((one) => one.best_fitness), list.map((one) => one.median_fitness)]);
  }

  return {
    card,
    chosen: () => (isDefault() ? {} : { t_b: t_b.value(), d_th: d_th.value() }),
    news(progress, known) {
      defaults = { t_b: progress.t_b, d_th: progress.d_th };
      card.hidden = known.list.length === 0;
      finds = progress.finds;
      hide();
      fitnessCard.hidden = !progress.minimises || known.list.every((one) => one.best_fitness === null);
      text(fitnessTitle, `${capital(progress.minimises)} by generation`);
      text(fitnessHint, `The quantity that the algorithm minimises.${progress.finds[0] === "boundary" ? " 0 is on the boundary." : ""}`);
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
    return valid; // while the input is incomplete, the last valid value
  };
  return { input, label: h("label", { for: id }, name, " ", input), value };
}
