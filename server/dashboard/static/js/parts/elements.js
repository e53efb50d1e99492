/** Small elements that several views share. Most have an ``update`` method, which changes only what differs. */

import { currentToken } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { figure, plural } from "../format.js";
import { rewrite } from "../router.js";

/** Return a badge: a state as a word, with a dot of its colour. */
export function badge(state, words = state) {
  const node = h("span", { class: `badge ${state}` }, words);
  node.update = (next, said = next) => {
    attribute(node, "class", `badge ${next}`);
    text(node, said);
  };
  return node;
}

const OUTCOMES = { held: "safe", other: "other", violated: "unsafe" };

/** Return a badge of a solution: what its verdict is about and what else it violated, with the colour of the verdict. */
export function outcomeBadge(one) {
  const node = badge(...outcomeWords(one));
  node.classList.add("long");
  const { update } = node;
  node.update = (next) => {
    update(...outcomeWords(next));
    node.classList.add("long");
  };
  return node;
}

/** Return a badge of whether a solution held the requirement that decides its verdict, in the colour of its outcome. */
export function requirementBadge(one) {
  return badge(OUTCOMES[one.kind], one.kind === "violated" ? "violated" : "held");
}

function outcomeWords(one) {
  return one.outcome ? [OUTCOMES[one.kind], one.outcome] : [one.verdict];
}

/** Return a highlighted message; ``kind`` is ``warn``, ``bad`` or empty. */
export function callout(kind, ...words) {
  return h("div", { class: `callout ${kind}`.trim() }, words);
}

/** Return a command of the command line, for this coordinator. */
export function command(words) {
  const server = new URL(".", document.baseURI).href.replace(/\/$/, "");
  return h("code", null, `${currentToken() ? "BRINK_TOKEN=… " : ""}${words} --server ${server}`);
}

/** Return the command that starts a worker for this coordinator. */
export function workerCommand() {
  return command("brink worker");
}

/**
 * Return which queued jobs wait for which kind of worker, in words.
 *
 * @param {object} read ``unrunnable`` and ``waits_for`` of a campaign or of all jobs.
 */
export function waitsFor(read) {
  const each = Object.entries(read.unrunnable).map(([needs, jobs]) => `${plural(jobs, "job")} ${jobs === 1 ? "waits" : "wait"} for ${read.waits_for[needs]}`);
  return each.length ? `${each.join("; ")}. ` : "";
}

/** Ask for confirmation of something that cannot be undone; resolves to whether it was given. */
export function sure(question, { yes = "Yes", danger = true } = {}) {
  return new Promise((resolve) => {
    const node = h("dialog.card", { "aria-label": question, onclose: () => {
      node.remove();
      resolve(node.returnValue === "yes");
    } }, h("form", { method: "dialog" }, h("p", null, question), h("div.actions", null,
      h(danger ? "button.danger" : "button.primary", { value: "yes" }, yes), h("button", { value: "no", autofocus: true }, "No"))));
    document.body.append(node);
    node.showModal();
    addEventListener("hashchange", () => node.close("no"), { once: true }); // the view that asked is no longer shown
  });
}

/**
 * Return a list of names with values; ``update`` takes another mapping of names to texts.
 *
 * @param {Record<string, string>} told Shown in this order; names that a later update omits are hidden.
 */
export function facts(told = {}) {
  const node = h("dl.facts");
  const known = new Map();
  node.update = (next) => {
    for (const [name, words] of Object.entries(next)) {
      if (!known.has(name)) {
        const value = h("dd");
        const pair = h("div", null, h("dt", null, name), value);
        known.set(name, { pair, value });
        node.append(pair);
      }
      text(known.get(name).value, words);
    }
    for (const [name, { pair }] of known) pair.hidden = !(name in next);
    const wanted = Object.keys(next).map((name) => known.get(name).pair);
    if (wanted.some((pair, index) => index > 0 && wanted[index - 1].compareDocumentPosition(pair) & Node.DOCUMENT_POSITION_PRECEDING)) node.append(...wanted);
  };
  node.update(told);
  return node;
}

/** Return a progress bar; ``update(share, ended)`` changes it. */
export function meter(label, share = 0, ended = false) {
  const bar = h("i");
  const node = h("div.meter", { role: "progressbar", "aria-label": label, "aria-valuemin": 0, "aria-valuemax": 100 }, bar);
  node.update = (next, over = false) => {
    const whole = Math.round(100 * Math.min(1, Math.max(0, next)));
    bar.style.width = `${whole}%`;
    attribute(node, "aria-valuenow", whole);
    node.classList.toggle("ended", over);
  };
  node.update(share, ended);
  return node;
}

const WIDTH = 96;
const HEIGHT = 24;

/** Return a sparkline: a line through values in a few pixels. */
export function sparkline(label, values = []) {
  const line = h("polyline", { fill: "none", stroke: "var(--safe)", "stroke-width": 1.6, "vector-effect": "non-scaling-stroke" });
  const node = h("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, width: WIDTH, height: HEIGHT, role: "img", "aria-label": label }, line);
  node.update = (next) => {
    const top = Math.max(1, ...next);
    const points = next.map((value, index) => {
      const x = next.length > 1 ? (index / (next.length - 1)) * WIDTH : WIDTH;
      return `${x.toFixed(1)},${(HEIGHT - 2 - (value / top) * (HEIGHT - 4)).toFixed(1)}`;
    });
    attribute(line, "points", points.join(" "));
    attribute(node, "aria-label", next.length ? `${label}: ${next.at(-1)} now` : `${label}: none yet`);
  };
  node.update(values);
  return node;
}

/**
 * Return a group of buttons of which one is pressed; ``update(choices, chosen)`` replaces them.
 *
 * @param {string} label What the buttons choose.
 * @param {(value: string) => void} choose Called with the chosen value.
 * @param {[value: string, words: string][]} choices
 * @param {string} chosen
 */
export function segments(label, choose, choices = [], chosen = "") {
  const node = h("div.segments", { role: "group", "aria-label": label });
  node.update = (next, taken) => {
    keyed(node, next, ([value]) => value, ([value]) => {
      const button = h("button", { type: "button", onclick: () => choose(value) });
      button.update = ([, words]) => text(button, words);
      return button;
    });
    for (const [index, button] of [...node.children].entries()) {
      button.update(next[index]);
      attribute(button, "aria-pressed", String(next[index][0] === taken));
    }
  };
  node.update(choices, chosen);
  return node;
}

/**
 * Return a table of few rows and columns that keeps its cells; ``update(columns, rows)`` changes their words.
 *
 * @param {string} label What it shows.
 * @param {string} corner Heading of the first column.
 *
 * Columns have a ``key`` and a ``head``: words, or a function that makes a node once. Rows have a ``key``, a ``label``
 * (words), optionally a ``class``, and ``cells``, one for each column.
 */
export function matrix(label, corner, { right = true } = {}) {
  const head = h("tr");
  const body = h("tbody");
  const node = h("div.scroll", { tabindex: 0, role: "region", "aria-label": label },
    h("table.matrix", null, h("caption.read-out", null, label), h("thead", null, head), body));
  const side = right ? "right" : "left";
  let known = null;

  function matrixRow(first) {
    const name = h("th", { scope: "row", class: first.class });
    const cells = first.cells.map(() => h("td", { class: [side, first.class].filter(Boolean).join(" ") }));
    const made = h("tr", null, name, cells);
    made.update = (row) => {
      text(name, row.label);
      cells.forEach((cell, index) => text(cell, row.cells[index]));
    };
    made.update(first);
    return made;
  }

  node.update = (columns, rows) => {
    const told = JSON.stringify(columns.map((column) => column.key));
    if (told !== known) {
      known = told;
      body.replaceChildren();
      replace(head, h("th", { scope: "col" }, corner), columns.map((column) =>
        h("th", { scope: "col", class: side }, typeof column.head === "function" ? column.head() : column.head)));
    }
    keyed(body, rows, (row) => row.key, matrixRow);
  };
  return node;
}

const MEASURES = [["strict", "Strict DBS"], ["dbs", "DBS"]];

/** Names of the measures within a sentence. */
export const NAMES = { strict: "strict DBS", dbs: "DBS" };

/**
 * Return the fields that choose DBS or strict DBS, t_b and d_th; the choice is kept in the address.
 *
 * @param {URLSearchParams} query Query of the address.
 * @param {() => void} changed Called when the choice changes.
 * @returns {HTMLElement} With ``update({t_bs, d_ths, t_b, d_th})``, the last two being defaults, and ``chosen``: ``measure``, ``t_b``,
 *   ``d_th`` and their indices ``i``, ``j``.
 */
export function thresholds(query, changed) {
  const chosen = { measure: query.get("measure") === "dbs" ? "dbs" : "strict", t_b: null, d_th: null, i: 0, j: 0 };
  const measure = segments("Measure", (taken) => choose({ measure: taken }), MEASURES, chosen.measure);
  const t_b = h("select", { onchange: () => choose({ t_b: Number(t_b.value) }) });
  const d_th = h("select", { onchange: () => choose({ d_th: Number(d_th.value) }) });
  const node = h("div.inline.thresholds", null, measure,
    h("label", { title: "Maximum fitness of a boundary solution" }, "t_b ", t_b),
    h("label", { title: "Minimum distance between two boundary solutions" }, "d_th ", d_th));
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
      const asked = chosen[name] ?? (query.has(name) ? Number(query.get(name)) : next[name]);
      chosen[name] = values.includes(asked) ? asked : values.includes(next[name]) ? next[name] : values[0];
    }
    settle();
  };
  return node;
}
