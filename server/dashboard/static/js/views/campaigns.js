/** The list of campaigns: status, tags and controls of each, its follow-ups folded below it. */

import { rowsOf, STATUSES } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { clause, count, percent, plainId, plural, rate, span, toldApart, when } from "../format.js";
import { go, link, place, rewrite } from "../router.js";
import { badge, callout, meter, sparkline, sure, workerCommand } from "../parts/elements.js";

const PAGE = 50;

export async function show(main, context, { query }) {
  context.title("Campaigns");
  const search = h("input", { type: "search", id: "search", placeholder: "Words in name, notes or tags", value: query.get("search") ?? query.get("name") ?? "" });
  const tags = listOf(query, "tag");
  const unfolded = listOf(query, "unfold");
  const tagged = h("ul.chips.tags", { "aria-label": "Only campaigns with these tags" });
  const here = { context, toggleTag, toggleFollowUps, isUnfolded: (id) => unfolded.has(id), isTagged: (tag) => tags.has(tag) };
  const status = h("select", { id: "status" }, h("option", { value: "" }, "any status"),
    STATUSES.map((name) => h("option", { value: name, selected: query.get("status") === name }, name)));
  const body = h("tbody");
  const notes = h("div");
  const empty = h("div.empty", { hidden: true });
  const table = h("div.card.scroll", { tabindex: 0, role: "region", "aria-label": "Campaigns" },
    h("table.campaigns", null, h("caption.read-out", null, "Campaigns, newest first"),
      h("thead", null, h("tr", null, [
        "Campaign", "Status", "Simulations", "Rate", "Time left", "Unsafe", "Found", "Submitted", "",
      ].map((words, index) => h("th", { scope: "col", class: HIDDEN[index] ?? null }, words || h("span.read-out", null, "Actions"))))),
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
        h("a", { href: link("campaigns"), "aria-label": "Show campaigns of all experiments" }, "×")), tagged),
    table, empty, h("div.inline.pages", null, newest, older, said));

  function path() {
    // What a status is asked for may be a follow-up.
    const asked = new URLSearchParams({ limit: PAGE, follow_ups: status.value ? "listed" : "hidden" });
    for (const [name, value] of [["search", search.value.trim()], ["status", status.value],
      ["cursor", place().query.get("cursor")], ["experiment", query.get("experiment")]]) {
      if (value) asked.set(name, value);
    }
    for (const tag of tags) asked.append("tag", tag);
    if (!status.value) for (const id of unfolded) asked.append("unfold", id);
    return `overview?${asked}`;
  }

  const polling = context.watch(path, take, {
    busy: (read) => read.status.some((one) => one === "running") || read.open_follow_ups.some((one) => one > 0) || read.found.some((one) => one === null),
  });
  here.polling = polling;

  let waiting = null;
  context.signal.addEventListener("abort", () => clearTimeout(waiting), { once: true });
  search.addEventListener("input", () => {
    clearTimeout(waiting);
    waiting = setTimeout(filtered, 250);
  });
  status.addEventListener("change", filtered);

  function filtered() {
    rewrite({ search: search.value.trim(), name: null, status: status.value, tag: [...tags].join(), cursor: null });
    showTags();
    polling.now();
  }

  function toggleTag(tag) {
    if (!tags.delete(tag)) tags.add(tag);
    filtered();
  }

  function showTags() {
    keyed(tagged, [...tags], (tag) => tag, (tag) => h("li.chip", null, tag, h("button.quiet", { type: "button", "aria-label": `Campaigns without the tag ${tag}, too`, onclick: () => {
      toggleTag(tag);
      search.focus(); // the button is gone
    } }, "×")));
  }

  function toggleFollowUps(id) {
    if (!unfolded.delete(id)) unfolded.add(id);
    rewrite({ unfold: [...unfolded].join() });
    polling.now();
  }

  showTags();

  function take(read) {
    const listed = new Set(read.id);
    const rows = toldApart(rowsOf(read)).map((row) => ({ ...row, ...(status.value ? { follow_ups: 0, nested: false } : { nested: listed.has(row.follow_up_of) }) }));
    keyed(body, rows, (row) => row.id, (row) => campaignRow(row, here));
    const found = rows.length > 0;
    const searching = Boolean(search.value.trim() || status.value || tags.size || query.get("experiment"));
    table.hidden = !found;
    empty.hidden = found;
    if (!found) replace(empty, ...nothing(searching, context));
    attribute(older, "href", read.next && link("campaigns", { ...Object.fromEntries(place().query), cursor: read.next }));
    older.hidden = !read.next;
    newest.hidden = !place().query.get("cursor");
    text(said, found ? shownOf(rows.filter((row) => !row.nested).length, read.total) : "");
    const running = rows.filter((row) => row.status === "running").length;
    const told = `${read.trouble} ${running > 0 && read.workers === 0}`;
    if (notes.dataset.told === told) return; // keeps selection and focus
    notes.dataset.told = told;
    replace(notes,
      read.trouble && callout("bad", `The database currently rejects writes: ${clause(read.trouble)}. No acknowledged result is lost.`),
      running > 0 && read.workers === 0 && callout("warn", "Campaigns are running, but no worker is. Start one: ", workerCommand()));
  }
}

const HIDDEN = { 3: "wide-only", 4: "wide-only", 6: "found", 7: "wide-only" };

/** Return how many campaigns are listed, and of how many if there are more. */
function shownOf(listed, total) {
  return listed < total ? `${count(listed)} of ${count(total)} shown` : `${count(listed)} shown`;
}

/** Return the values of a list in the query of an address. */
function listOf(query, name) {
  return new Set((query.get(name) ?? "").split(",").filter(Boolean));
}

function nothing(searching, context) {
  if (searching) return [h("p", null, "No campaign matches.")];
  return [h("h2", null, "No campaigns yet"), h("p", null, "A campaign consists of a system, a safety requirement, a search algorithm and a budget of simulations."),
    context.may.steer ? h("p", null, h("a.button.primary", { href: link("new") }, "Submit the first one"))
      : h("p", null, "This token is read-only. A token of scope user can submit campaigns.")];
}

/**
 * Return the row of a campaign; ``update`` takes its later states.
 *
 * @param {object} first Its state.
 * @param {object} here The list: its ``context`` and ``polling``, ``toggleTag``, ``toggleFollowUps``, and what is chosen.
 */
function campaignRow(first, here) {
  const { context, polling } = here;
  const name = h("a.row", { href: link("campaigns", first.id) }, first.name);
  const alike = h("code.alike");
  const tags = h("ul.chips.tags", { "aria-label": `Tags of ${first.name}` });
  const followUps = h("button.quiet.fold", { type: "button", hidden: true, onclick: () => here.toggleFollowUps(first.id) });
  const about = h("div.small.muted", null, `${plainId(first.problem)} · ${plainId(first.algorithm)} · seed ${first.seed} `,
    first.experiment && h("a", { href: link("experiments", first.experiment) }, "experiment"),
    first.follow_up_of && h("a", { href: link("campaigns", first.follow_up_of) }, "follow-up"));
  const state = badge(first.status);
  const done = meter(`Simulations of ${first.name}`);
  const numbers = h("span.small");
  const speed = h("td.wide-only");
  const left = h("td.wide-only");
  const unsafe = h("td");
  const spark = sparkline("Boundary solutions");
  const found = h("span");
  const foundOnPhone = h("div.small.narrow-only");
  const actions = h("td.actions-cell");
  const node = h("tr", null, h("th.name", { scope: "row" }, name, " ", alike, about, foundOnPhone, tags, followUps), h("td", null, state), h("td.progress", null, done, numbers),
    speed, left, unsafe, h("td.found", null, found, spark), h("td.wide-only.small", null, when(first.created_at)), actions);
  let drawn = null;

  node.update = (row) => {
    text(alike, row.alike);
    node.classList.toggle("nested", row.nested);
    keyed(tags, row.tags, (tag) => tag, (tag) => h("li", null, h("button.tag", { type: "button", title: "Only campaigns with this tag", onclick: () => here.toggleTag(tag) }, tag)));
    for (const each of tags.children) attribute(each.firstChild, "aria-pressed", String(here.isTagged(each.dataset.key)));
    showFollowUps(row);
    state.update(row.status);
    attribute(state, "title", row.status_reason || null);
    done.update(row.simulations / row.budget, row.finished_at !== null);
    text(numbers, `${count(row.simulations)} of ${count(row.budget)}${row.failed ? `, ${count(row.failed)} failed` : ""}`);
    text(speed, row.status === "running" ? rate(row.rate_per_s) : "–");
    text(left, row.status === "running" ? span(row.remaining_s) : "–");
    text(unsafe, row.evaluated ? percent(row.unsafe / row.evaluated) : "–");
    text(found, row.found ?? "being worked out");
    text(foundOnPhone, row.found ?? "");
    attribute(found, "title", row.found === null ? "Being worked out" : null);
    const line = row.found_kind === "boundary" && row.dbs.some((one) => one > 0) ? row.dbs : [];
    spark.classList.toggle("none", line.length === 0);
    spark.update(line);
    if (drawn !== row.status) {
      drawn = row.status;
      const inside = actions.contains(document.activeElement);
      replace(actions, context.may.steer && steering(row, context, polling, { clonable: !row.follow_up_of }));
      if (inside) actions.querySelector("button")?.focus();
    }
  };

  function showFollowUps({ follow_ups: all, open_follow_ups: open }) {
    const isUnfolded = here.isUnfolded(first.id);
    followUps.hidden = all === 0;
    attribute(followUps, "aria-expanded", String(isUnfolded));
    text(followUps, `${isUnfolded ? "−" : "+"}${plural(all, "follow-up")}${open ? `, ${count(open)} under way` : ""}`);
  }

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
