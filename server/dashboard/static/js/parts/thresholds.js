/** Which figure is looked at: DBS or strict DBS, for which t_b and d_th. */

import { h, keyed } from "../dom.js";
import { figure } from "../format.js";
import { rewrite } from "../router.js";
import { segments } from "./segments.js";

const MEASURES = [["strict", "Strict DBS"], ["dbs", "DBS"]];
const USUAL = { t_b: 0.1, d_th: 0.2 };

/** What a measure is called within a sentence. */
export const NAMES = { strict: "strict DBS", dbs: "DBS" };

/**
 * Return fields that choose; what is chosen stands in the address.
 *
 * @param {URLSearchParams} query What the address says.
 * @param {() => void} changed Called when something else is chosen.
 * @returns {HTMLElement} With ``update({t_bs, d_ths})``, and ``chosen``: ``measure``, ``t_b``, ``d_th``, and their places ``i``, ``j``.
 */
export function thresholds(query, changed) {
  const chosen = { measure: query.get("measure") === "dbs" ? "dbs" : "strict", t_b: null, d_th: null, i: 0, j: 0 };
  const measure = segments("Measure", (taken) => choose({ measure: taken }), MEASURES, chosen.measure);
  const t_b = h("select", { onchange: () => choose({ t_b: Number(t_b.value) }) });
  const d_th = h("select", { onchange: () => choose({ d_th: Number(d_th.value) }) });
  const node = h("div.inline.thresholds", null, measure,
    h("label", { title: "Largest fitness of a solution that counts as one of the boundary" }, "t_b ", t_b),
    h("label", { title: "Least distance between two solutions that both count" }, "d_th ", d_th));
  let known = { t_bs: [], d_ths: [] };
  node.chosen = chosen;

  function choose(changes) {
    Object.assign(chosen, changes);
    settle();
    rewrite({ measure: chosen.measure, t_b: chosen.t_b, d_th: chosen.d_th });
    changed();
  }

  function settle() {
    chosen.i = known.t_bs.indexOf(chosen.t_b);
    chosen.j = known.d_ths.indexOf(chosen.d_th);
    measure.update(MEASURES, chosen.measure);
    for (const [select, values, value] of [[t_b, known.t_bs, chosen.t_b], [d_th, known.d_ths, chosen.d_th]]) {
      keyed(select, values, String, (one) => h("option", { value: one }, figure(one)));
      select.value = String(value);
    }
  }

  node.update = (next) => {
    known = next;
    for (const [name, values] of [["t_b", next.t_bs], ["d_th", next.d_ths]]) {
      const asked = chosen[name] ?? (query.has(name) ? Number(query.get(name)) : USUAL[name]);
      chosen[name] = values.includes(asked) ? asked : values.includes(USUAL[name]) ? USUAL[name] : values[0];
    }
    settle();
  };
  return node;
}
