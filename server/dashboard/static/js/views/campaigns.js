/** The list of campaigns: status and controls of each. */

import { rowsOf, STATUSES } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { count, percent, plainId, rate, span, toldApart, when } from "../format.js";
import { go, link, place, rewrite } from "../router.js";
import { badge, callout, meter, sparkline, sure, workerCommand } from "../parts/elements.js";

const PAGE = 50;

export async function show(main, context, { query }) {
  context.title("Campaigns");
  const search = h("input", { type: "search", id: "search", placeholder: "Name or id", value: query.get("name") ?? "" });
  const status = h("select", { id: "status" }, h("option", { value: "" }, "any status"),
    STATUSES.map((name) => h("option", { value: name, selected: query.get("status") === name }, name)));
  const body = h("tbody");
  const notes = h("div");
  const empty = h("div.empty", { hidden: true });
  const table = h("div.card.scroll", { tabindex: 0, role: "region", "aria-label": "Campaigns" },
    h("table.campaigns", null, h("caption.read-out", null, "Campaigns, newest first"),
      h("thead", null, h("tr", null, [
        "Campaign", "Status", "Simulations", "Rate", "Time left", "Unsafe", "Boundary solutions", "Submitted", "",
      ].map((words, index) => h(index === 6 ? "th.dbs" : "th", { scope: "col", class: HIDDEN[index] ?? null }, words || h("span.read-out", null, "Actions"))))),
      body));
  const older = h("a.button", { hidden: true }, "Older");
  const newest = h("a.button", { href: link("campaigns"), hidden: !query.get("cursor") }, "Newest");
  const said = h("p.hint", { "aria-live": "polite" });

  replace(main,
    h("div.head", null, h("h1", null, "Campaigns"),
      context.may.steer && h("a.button.primary.push", { href: link("new") }, "New campaign")),
    notes,
    h("form.inline.filters", { role: "search", onsubmit: (event) => event.preventDefault() },
      h("label", { for: "search" }, "Find"), search, h("label", { for: "status" }, "Status"), status,
      query.get("experiment") && h("span.badge", null, `experiment ${query.get("experiment")} `,
        h("a", { href: link("campaigns"), "aria-label": "Show campaigns of all experiments" }, "×"))),
    table, empty, h("div.inline.pages", null, newest, older, said));

  function path() {
    const asked = new URLSearchParams({ limit: PAGE });
    for (const [name, value] of [["name", search.value.trim()], ["status", status.value],
      ["cursor", place().query.get("cursor")], ["experiment", query.get("experiment")]]) {
      if (value) asked.set(name, value);
    }
    return `overview?${asked}`;
  }

  const polling = context.watch(path, take, {
    busy: (read) => read.status.some((one) => one === "running"),
  });

  let waiting = null;
  context.signal.addEventListener("abort", () => clearTimeout(waiting), { once: true });
  search.addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(filtered, 250);
  });
  status.addEventListener("change", filtered);

  function filtered() {
    rewrite({ name: search.value.trim(), status: status.value, cursor: null });
    polling.now();
  }

  function take(read) {
    const rows = toldApart(rowsOf(read));
    keyed(body, rows, (row) => row.id, (row) => campaignRow(row, context, polling));
    const found = rows.length > 0;
    const searching = Boolean(search.value.trim() || status.value || query.get("experiment"));
    table.hidden = !found;
    empty.hidden = found;
    if (!found) replace(empty, ...nothing(searching, context));
    attribute(older, "href", read.next && link("campaigns", { ...Object.fromEntries(place().query), cursor: read.next }));
    older.hidden = !read.next;
    newest.hidden = !place().query.get("cursor");
    text(said, found ? `${count(rows.length)} shown` : "");
    const running = rows.filter((row) => row.status === "running").length;
    const told = `${read.trouble} ${running > 0 && read.workers === 0}`;
    if (notes.dataset.told === told) return; // keeps selection and focus
    notes.dataset.told = told;
    replace(notes,
      read.trouble && callout("bad", `The database currently rejects writes: ${read.trouble}. No acknowledged result is lost.`),
      running > 0 && read.workers === 0 && callout("warn", "Campaigns are running, but no worker is. Start one: ", workerCommand()));
  }
}

const HIDDEN = { 3: "wide-only", 4: "wide-only", 7: "wide-only" };

function nothing(searching, context) {
  if (searching) return [h("p", null, "No campaign matches.")];
  return [h("h2", null, "No campaigns yet"), h("p", null, "A campaign consists of a system, a safety requirement, a search algorithm and a budget of simulations."),
    context.may.steer ? h("p", null, h("a.button.primary", { href: link("new") }, "Submit the first one"))
      : h("p", null, "This token is read-only. A token of scope user can submit campaigns.")];
}

function campaignRow(first, context, polling) {
  const name = h("a.row", { href: link("campaigns", first.id) }, first.name);
  const alike = h("code.alike");
  const about = h("div.small.muted", null, `${plainId(first.problem)} · ${plainId(first.algorithm)} · seed ${first.seed} `,
    first.experiment && h("a", { href: link("experiments", first.experiment) }, "experiment"),
    first.repeats_of && h("a", { href: link("campaigns", first.repeats_of) }, "repeats"));
  const state = badge(first.status);
  const done = meter(`Simulations of ${first.name}`);
  const numbers = h("span.small");
  const speed = h("td.wide-only");
  const left = h("td.wide-only");
  const unsafe = h("td");
  const spark = sparkline("Boundary solutions");
  const dbs = h("span");
  const actions = h("td.actions-cell");
  const node = h("tr", null, h("th.name", { scope: "row" }, name, " ", alike, about), h("td", null, state), h("td.progress", null, done, numbers),
    speed, left, unsafe, h("td.dbs", null, spark, " ", dbs), h("td.wide-only.small", null, when(first.created_at)), actions);
  let drawn = null;

  node.update = (row) => {
    text(alike, row.alike);
    state.update(row.status);
    attribute(state, "title", row.status_reason || null);
    done.update(row.simulations / row.budget, row.finished_at !== null);
    text(numbers, `${count(row.simulations)} of ${count(row.budget)}${row.failed ? `, ${count(row.failed)} failed` : ""}`);
    text(speed, row.status === "running" ? rate(row.rate_per_s) : "–");
    text(left, row.status === "running" ? span(row.remaining_s) : "–");
    text(unsafe, row.evaluated ? percent(row.unsafe / row.evaluated) : "–");
    const counts = row.looks_for_boundary ? row.dbs : [];
    spark.update(counts);
    text(dbs, counts.length ? count(counts.at(-1)) : "–");
    if (drawn !== row.status) {
      drawn = row.status;
      const inside = actions.contains(document.activeElement);
      replace(actions, context.may.steer && steering(row, context, polling, { clonable: !row.repeats_of }));
      if (inside) actions.querySelector("button")?.focus();
    }
  };
  node.update(first);
  return node;
}

/** Return the buttons that control a campaign in its current state. Repeats cannot be cloned, as they belong to a campaign. */
export function steering(row, context, polling, { clonable = true } = {}) {
  const path = `campaigns/${row.id}`;
  const act = async (method, way, said) => {
    await context.act(method, path + way, said);
    polling.now();
  };
  const button = (words, doing, kind = "quiet") => h(`button.${kind}`, { type: "button", "aria-label": `${words} ${row.name}`, onclick: doing }, words);
  return h("div.actions", null,
    row.status === "running" && button("Pause", () => act("POST", "/pause", `${row.name} is paused; results of running jobs are still accepted.`)),
    row.status === "paused" && button("Resume", () => act("POST", "/resume", `${row.name} is running again.`)),
    (row.status === "running" || row.status === "paused") && button("Cancel", async () => {
      if (await sure(`Cancel ${row.name}? Its results are kept, but it cannot be resumed.`, { yes: "Cancel campaign" })) await act("POST", "/cancel", `${row.name} has been cancelled.`);
    }),
    clonable && button("Clone", () => go("new", { from: row.id })));
}
