/** Workers: which are live, what each can run and holds, and how fast it is; and to drain them. */

import { serverNow } from "../api.js";
import { attribute, h, keyed, replace, text } from "../dom.js";
import { ago, count, plural, rate } from "../format.js";
import { link } from "../router.js";
import { badge, callout, facts, sure, waitsFor, workerCommand } from "../parts/elements.js";

const COLUMNS = ["Worker", "State", "Jobs", "Rate", "Done", "Failed", "Last seen", "Can run", "Version"];
const ACTIONS = "Actions";
const RIGHT = new Set(["Done", "Failed"]);
const LISTED = 500;

export async function show(main, context) {
  context.title("Workers");
  const totals = facts();
  const notes = h("div");
  const old = h("input", { type: "checkbox", onchange: () => draw() });
  const oldWords = h("span");
  const oldLine = h("label.check", { hidden: true }, old, oldWords);
  const body = h("tbody");
  const table = h("div.card.scroll", { tabindex: 0, role: "region", "aria-label": "Workers", hidden: true }, h("table.workers", null,
    h("caption.read-out", null, "Workers, most recently seen first"),
    h("thead", null, h("tr", null, COLUMNS.map((words) => h("th", { scope: "col", class: RIGHT.has(words) ? "right" : null }, words)),
      context.may.operate && h("th", { scope: "col" }, h("span.read-out", null, ACTIONS)))), body));
  const nobody = h("div.empty", { hidden: true }, h("h2", null, "No workers yet"),
    h("p", null, "Workers run the simulations. Start one per core, on any machine that can reach the coordinator:"),
    h("p", null, workerCommand()));
  const more = h("p.hint", { hidden: true }, "To add a worker: ", workerCommand(), ". Start one per core.");
  replace(main, h("div.head", null, h("h1", null, "Workers")),
    h("section.card.totals", { "aria-label": "All workers" }, totals), notes, oldLine, table, nobody, more);

  const paces = new Map();
  let workers = null;
  let held = new Map();
  let names = {};
  let unmet = "";

  /** Ask a worker to finish what it holds, and to exit. */
  async function drain(row) {
    const question = `Drain ${row.id}? It finishes the jobs that it holds, takes no more, and exits.`;
    if (!await sure(question, { yes: "Drain", danger: false })) return;
    await context.act("POST", `workers/${encodeURIComponent(row.id)}/drain`, `${row.id} finishes the jobs that it holds.`);
    polling.now({ afresh: true });
  }

  const polling = context.watch("workers", (read) => {
    workers = read;
    for (const id of paces.keys()) if (!read.some((worker) => worker.id === id)) paces.delete(id);
    draw();
  }, { busy: (read) => read.some((worker) => worker.live) });
  context.watch(`jobs?status=leased&limit=${LISTED}`, (read) => {
    held = byWorker(read.jobs);
    draw();
  }, { busy: (read) => read.jobs.length > 0 });
  context.watch("jobs/counts", (read) => {
    names = read.campaigns;
    unmet = waitsFor(read);
    draw();
  }, { busy: (read) => read.status.length > 0 });
  const ticking = setInterval(() => !document.hidden && draw(), 1_000);
  context.signal.addEventListener("abort", () => clearInterval(ticking), { once: true });

  function draw() {
    if (workers === null) return;
    const now = serverNow();
    const rows = workers.map((worker) => ({ ...worker, ...speed(worker, now), jobs: (held.get(worker.id) ?? []).map(named), now }));
    const live = rows.filter((row) => row.live);
    const gone = rows.length - live.length;
    keyed(body, old.checked ? rows : live, (row) => row.id, (row) => workerRow(row, context.may.operate && drain));
    table.hidden = !old.checked && !live.length;
    more.hidden = live.length === 0;
    nobody.hidden = rows.length > 0;
    totals.parentElement.hidden = rows.length === 0;
    oldLine.hidden = gone === 0;
    text(oldWords, `Show ${plural(gone, "worker")} that ${gone === 1 ? "is" : "are"} gone`);
    totals.update({
      "Live workers": count(live.length), "Jobs held": count(sum(rows, "jobs_held")), "Total rate": said(sum(live, "perSecond")),
      "Jobs done": count(sum(rows, "jobs_done")), "Failed attempts": count(sum(rows, "jobs_failed")),
    });
    note(notes, rows, live, unmet);
  }

  function named(job) {
    return { ...job, name: names[job.campaign] ?? job.campaign };
  }

  function speed(worker, now) {
    if (!paces.has(worker.id)) paces.set(worker.id, new Pace());
    const pace = paces.get(worker.id);
    pace.note(worker.jobs_done, now);
    const recent = worker.live ? pace.perSecond(now) : null;
    if (recent !== null) return { perSecond: recent, over: "last minute" };
    const there = (Date.parse(worker.last_seen_at) - Date.parse(worker.first_seen_at)) / 1000;
    return { perSecond: there > 0 ? worker.jobs_done / there : null, over: "since its start" };
  }
}

function note(place, rows, live, unmet) {
  const told = JSON.stringify([rows.length > 0 && live.length === 0, unmet]);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place,
    rows.length > 0 && live.length === 0 && callout("warn", "No worker is running. ", unmet, "Start one: ", workerCommand()),
    live.length > 0 && unmet && callout("warn", "No live worker can run all jobs: ", unmet, h("a", { href: link("jobs", { status: "queued" }) }, "Show them")));
}

function workerRow(first, drain) {
  const state = badge("live");
  const list = h("ul.held");
  const many = h("summary");
  const holds = h("details", null, many, list);
  const none = h("span.muted", null, "none");
  const speed = h("span");
  const over = h("div.small.muted");
  const done = h("td.right");
  const failed = h("td.right");
  const seen = h("td");
  const able = h("ul.able");
  const about = h("div.small.muted");
  const release = h("td.small");
  const button = drain && h("button.quiet", { type: "button", "aria-label": `Drain ${first.id}`, onclick: () => drain(first) }, "Drain");
  const node = h("tr", null, h("th", { scope: "row" }, h("span.mono", null, first.id), about), h("td", null, state),
    h("td", null, holds, none), h("td", null, speed, over), done, failed, seen, h("td", null, able), release, button && h("td", null, button));
  node.update = (row) => {
    text(about, `${row.host}, process ${row.pid}`);
    state.update(!row.live ? "gone" : row.draining ? "draining" : "live");
    if (button) button.hidden = !row.live || row.draining;
    holds.hidden = row.jobs_held === 0;
    none.hidden = row.jobs_held > 0;
    text(many, plural(row.jobs_held, "job"));
    keyed(list, row.jobs, (job) => job.id, heldJob);
    text(speed, said(row.perSecond));
    text(over, row.over);
    text(done, count(row.jobs_done));
    text(failed, count(row.jobs_failed));
    attribute(failed, "class", row.jobs_failed ? "right some-failed" : "right");
    text(seen, ago(row.last_seen_at, row.now));
    keyed(able, row.capabilities, (one) => one, (one) => h("li", null, one));
    text(release, row.version);
  };
  node.update(first);
  return node;
}

function heldJob(first) {
  const campaign = h("a", { href: link("campaigns", first.campaign) });
  const node = h("li", null, first.kind === "episode" ? "" : `${first.kind} of `,
    h("a", { href: link("campaigns", first.campaign, "solutions", first.number) }, `solution ${first.number}`), " of ", campaign);
  node.update = (job) => text(campaign, job.name);
  node.update(first);
  return node;
}

function byWorker(jobs) {
  const found = new Map();
  for (const job of jobs) {
    if (!found.has(job.worker)) found.set(job.worker, []);
    found.get(job.worker).push(job);
  }
  return found;
}

function sum(rows, name) {
  return rows.reduce((total, row) => total + (row[name] ?? 0), 0);
}

function said(perSecond) {
  return perSecond === 0 ? "none" : rate(perSecond);
}

const OVER_MS = 60_000;
const EVERY_MS = 5_000;
const LEAST_MS = 10_000;

/** How fast a count grows, from observations of the last minute. */
class Pace {
  #seen = []; // pairs of time and count, some seconds apart
  #count = 0;

  /** Record the current count. */
  note(count, nowMs) {
    if (count < this.#count) this.#seen = []; // a new worker with the same id
    this.#count = count;
    if (!this.#seen.length || nowMs - this.#seen.at(-1)[0] >= EVERY_MS) this.#seen.push([nowMs, count]);
    while (this.#seen.length > 2 && nowMs - this.#seen[1][0] > OVER_MS) this.#seen.shift();
  }

  /** Return the growth per second, or null while there are too few observations. */
  perSecond(nowMs) {
    const [since, before] = this.#seen[0] ?? [nowMs, 0];
    return nowMs - since < LEAST_MS ? null : (this.#count - before) / ((nowMs - since) / 1000);
  }
}
