/** Tables and conclusions of an experiment, and their loading. */

import { ApiError } from "../../api.js";
import { h, text } from "../../dom.js";
import { capital, figure } from "../../format.js";
import { whenMade } from "../../polling.js";

/**
 * Load a path whenever there is more to show, waiting while its response is computed.
 *
 * @param {string} path The path.
 * @param {object} context Of the view.
 * @param {HTMLElement} place Where to say what is being computed.
 * @param {(read: *) => void} take Called with each response.
 * @returns {{want: (version: number|string) => void}} ``want`` says what there is, such as how many campaigns have finished.
 */
export function loadWhenFinished(path, context, place, take) {
  let wanted = 0;
  let taken = 0;
  let under_way = false;

  async function look() {
    if (under_way || wanted === taken) return;
    under_way = true;
    const asked = wanted;
    try {
      const read = await whenMade(path, { ...context.retrying, making, firstS: 2, waitS: 2 });
      text(place, "");
      take(read);
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) return void context.signIn();
      text(place, `The results cannot be shown: ${error.message}`);
    } finally {
      under_way = false;
    }
    taken = asked;
    look();
  }

  function making({ detail }) {
    text(place, `${capital(detail)}; the tables appear when that is done.`);
  }

  return { want: (version) => { wanted = version; look(); } };
}

/** Return a list item with names in bold, figures and a conclusion; ``update`` takes a key and the three texts. */
export function sentence(first) {
  const who = h("strong");
  const figures = h("span");
  const says = h("span");
  const node = h("li", null, who, figures, says);
  node.update = ([, names, told, concluded]) => {
    text(who, names);
    text(figures, told);
    text(says, concluded);
  };
  node.update(first);
  return node;
}

/** Return a table with named columns, each with whether it is aligned right; ``body`` takes the rows. */
export function tableOf(label, columns) {
  const body = h("tbody");
  const node = h("div.scroll", { tabindex: 0, role: "region", "aria-label": label },
    h("table", null, h("caption.read-out", null, label), h("thead", null, h("tr", null, columns.map(([words, right]) =>
      h("th", { scope: "col", class: right ? "right" : null }, words)))), body));
  node.body = body;
  return node;
}

/** Return a function that creates table rows; ``say(item)`` returns the texts of the heading and the cells. */
export function plainRow(say, rights) {
  return (first) => {
    const name = h("th", { scope: "row" });
    const cells = rights.map((right) => h(right ? "td.right" : "td"));
    const node = h("tr", null, name, cells);
    node.update = (item) => [name, ...cells].forEach((cell, index) => text(cell, say(item)[index]));
    node.update(first);
    return node;
  };
}

/** Return the figures of a test, to follow the means; nothing if all values are equal, and nothing is tested. */
export function tested(one) {
  if (one.p === null) return "";
  return `, U ${figure(one.u)}, A12 ${one.a12.toFixed(2)} (${one.effect}), p ${pValue(one.p)}, corrected ${pValue(one.p_holm)}`;
}

/** Return a p value in words: ``< .001`` or ``0.024``; of null, where all values are equal and nothing is tested, ``equal``. */
export function pValue(value) {
  if (value === null) return "equal";
  return value < 0.001 ? "< .001" : value.toFixed(3);
}
