/** Whether the detector of another campaign meets the requirement that tolerances are. */

import { rowsOf } from "../api.js";
import { h, keyed, replace, text } from "../dom.js";
import { capital, count, percent } from "../format.js";
import { command } from "../parts/elements.js";
import { link } from "../router.js";

const BADGES = { "not met": "failed", "met": "finished", "not enough data": "paused" };
const WIDTH = 160;

/** Return a part that lists campaigns with a detector in the loop when it is opened, and checks the one that is chosen. */
export function detectorCheck(context, id) {
  const campaigns = h("select", { onchange: () => context.tell(check) });
  const none = h("p.hint", { hidden: true });
  const note = h("p.verdict", { "aria-live": "polite" });
  const meaning = h("p.hint");
  const next = h("ul.plain", { "aria-label": "What to record next" });
  const table = resultsTable();
  const rest = h("p.hint");
  const found = h("div", { hidden: true }, note, meaning, h("h4", null, "What to record next"), next, table, rest);
  const node = h("details.detector", { ontoggle: () => node.open && context.tell(list) },
    h("summary", null, h("h3", null, "Does a detector meet it?")),
    h("p", null, h("label", null, "Detector of the campaign ", campaigns)), none,
    h("p.hint", null, "Recordings are checked on the command line: ", command(`brink tolerance ${id} --detections PATH`)),
    found);

  async function list() {
    const problems = await context.get("problems");
    const measuring = new Set(problems.filter((problem) => problem.measures_detector).map((problem) => problem.id));
    text(none, `No campaign has a detector in the loop yet. Start one on ${[...measuring].join(" or ")}.`);
    const rows = rowsOf(await context.get("overview?limit=200&follow_ups=hidden")).filter((row) => measuring.has(row.problem));
    none.hidden = rows.length > 0;
    keyed(campaigns, [{ id: "", name: "choose one" }, ...rows], (row) => row.id,
      (row) => h("option", { value: row.id }, row.id ? `${row.name} (${row.id})` : row.name));
  }

  async function check() {
    const episodes = campaigns.value;
    found.hidden = true;
    if (!episodes) return;
    const read = await context.get(`campaigns/${id}/tolerance/detector?episodes=${encodeURIComponent(episodes)}`);
    if (campaigns.value !== episodes) return;
    text(note, `${read.note}.`);
    text(meaning, read.meaning);
    keyed(next, read.next, (words) => words, (words) => h("li", null, `${words}.`));
    for (const part of [next, next.previousElementSibling]) part.hidden = read.next.length === 0;
    table.update(read, episodes);
    text(rest, [read.no_data, ...read.conditions.filter((one) => one.violations !== null && one.drives > 0)
      .map((one) => `${capital(one.condition)}: ${one.violations} of ${count(one.drives)} drives with this detector violate.`)].filter(Boolean).join(" "));
    found.hidden = false;
  }

  return node;
}

function resultsTable() {
  const body = h("tbody");
  const share = h("th", { scope: "col" });
  const heads = (kind, ...names) => names.map((name) => h(kind, { scope: "col" }, name));
  const node = h("div.scroll.tall", { tabindex: 0, role: "region", "aria-label": "Results of the detector" }, h("table", null,
    h("caption.read-out", null, "Whether the detector meets the requirement, by type of error and condition"),
    h("thead", null, h("tr", null, heads("th", "Result", "Error", "Condition"), heads("th.right", "Drives", "Median", "95% within"), share, heads("th", "Worst drives"))), body));

  node.update = (read, episodes) => {
    text(share, `Violate, limit ${percent(read.limit)}`);
    const cells = read.cells.filter((cell) => cell.share !== null);
    node.hidden = cells.length === 0;
    replace(body, cells.map((cell) => h("tr", { title: cell.sentence },
      h("td", null, h("span", { class: `badge ${BADGES[cell.result]}` }, cell.result), h("span.read-out", null, cell.sentence)),
      h("th", { scope: "row" }, capital(cell.error)), h("td", null, cell.condition),
      h("td.right", null, count(cell.drives)), h("td.right", null, magnitude(cell, cell.typical)), h("td.right", null, magnitude(cell, cell.grossest)),
      h("td.share", null, bar(cell, read.limit), h("span.small", null, `${percent(cell.share)} [${percent(cell.low)}, ${percent(cell.high)}]`)),
      h("td", null, cell.worst.slice(0, 3).map((drive, place) => [place > 0 && ", ", h("a", { href: link("campaigns", episodes, "solutions", drive) }, drive)])))));
  };
  return node;
}

/** ``≥ 4.0 s`` if a drive was cut off. */
function magnitude(cell, value) {
  const digits = cell.unit === "%" ? `${value.toFixed(0)}%` : `${value.toFixed(1)} ${cell.unit}`.trim();
  return `${cell.at_least ? "≥ " : ""}${digits}`;
}

/** Return an interval against the limit, on a scale on which small shares can be told apart: of their square roots. */
function bar(cell, limit) {
  const x = (share) => (WIDTH * Math.sqrt(share)).toFixed(1);
  return h(`svg.bar.${cell.result.replaceAll(" ", "-")}`, { viewBox: `0 0 ${WIDTH} 14`, width: WIDTH, height: 14, "aria-hidden": "true" },
    h("line", { x1: 0, x2: WIDTH, y1: 7, y2: 7, stroke: "var(--line)" }),
    h("rect", { x: x(cell.low), y: 3, width: Math.max(1.5, x(cell.high) - x(cell.low)), height: 8, rx: 2, fill: "var(--of)", opacity: 0.4 }),
    h("circle", { cx: x(cell.share), cy: 7, r: 3.5, fill: "var(--of)" }),
    h("line", { x1: x(limit), x2: x(limit), y1: 0, y2: 14, stroke: "var(--ink)", "stroke-dasharray": "3 2" }));
}
