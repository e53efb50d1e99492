/** Unfinished jobs: in quarantine with their errors, leased, or queued. */

import { ApiError, get, rowsOf, send, serverNow } from "../api.js";
import { toast } from "../context.js";
import { h, keyed, replace, text } from "../dom.js";
import { ago, count, plural, when } from "../format.js";
import { link, rewrite } from "../router.js";
import { callout, segments, sure, waitsFor, workerCommand } from "../parts/elements.js";

const STATUSES = ["quarantined", "leased", "queued"];
const WORDS = { quarantined: "In quarantine", leased: "Leased", queued: "Queued" };
const HINTS = {
  quarantined: "Jobs that failed at every attempt, or lost their worker too often. Campaigns continue without them. Jobs of campaigns that have not ended can be retried.",
  leased: "Jobs that a worker is running or will run next.",
  queued: "Jobs that wait for a worker. Jobs that failed before are leased alone.",
};
const KINDS = { episode: "", trace: "trace of ", "dataset-evaluation": "measurement of " };
const PAGE = 50;

export async function show(main, context, { query }) {
  context.title("Jobs");
  const chosen = {
    status: STATUSES.includes(query.get("status")) ? query.get("status") : null,
    campaign: /^[0-9a-z]+$/.test(query.get("campaign") ?? "") ? query.get("campaign") : "",
    after: Number.parseInt(query.get("after") ?? "0", 10) || 0,
  };
  const page = pageOf(context, choose, retry, retryAll);
  let counts = null;
  let list = null;
  let taken = null;

  replace(main, h("div.head", null, h("h1", null, "Jobs")), page.notes, page.filters, page.hint, page.table, page.empty, page.pages);
  const counting = context.watch("jobs/counts", (read) => {
    counts = read;
    chosen.status ??= firstLook(read);
    page.tally(read, chosen);
    list ??= context.watch(listed, take, { busy: () => chosen.status === "leased" || howMany(counts, "leased") > 0 });
  }, { busy: (read) => read.status.some((status) => status !== "quarantined") });

  function listed() {
    return `jobs?${asked({ limit: PAGE, after: chosen.after })}`;
  }

  function asked(more) {
    const query = new URLSearchParams({ status: chosen.status, ...more });
    if (chosen.campaign) query.set("campaign", chosen.campaign);
    return query;
  }

  function take(read) {
    // The response may belong to the previous choice.
    const jobs = read.jobs.filter((job) => job.status === chosen.status && job.id > chosen.after && (!chosen.campaign || job.campaign === chosen.campaign));
    taken = { jobs, next: read.next };
    draw();
  }

  function draw() {
    if (taken !== null && !document.hidden) page.list(taken.jobs, counts, chosen, taken.next);
  }
  const ticking = setInterval(draw, 2_000); // updates ages
  context.signal.addEventListener("abort", () => clearInterval(ticking), { once: true });

  function choose(changes) {
    taken = null;
    Object.assign(chosen, { after: 0, ...changes });
    rewrite({ status: chosen.status, campaign: chosen.campaign, after: chosen.after || null });
    page.tally(counts, chosen);
    page.list([], counts, chosen, null, { waiting: true });
    list.now({ afresh: true });
  }

  async function retry(job) {
    await context.act("POST", `jobs/${job.id}/retry`, `Job ${job.id} is back in the queue.`);
    lookAgain();
  }

  async function retryAll() {
    const many = retriable(counts, chosen.campaign);
    const of = Object.fromEntries(asked({})); // fixed, even if the choice changes in the meantime
    if (!(await sure(`Put ${plural(many, "job")} back into the queue?`, { yes: "Retry", danger: false }))) return;
    try {
      await retryEach((after) => `jobs?${new URLSearchParams({ ...of, limit: 200, after })}`, (job) => isAwaited(job, counts), context.signal);
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) context.signIn();
      else toast(error.message, { bad: true });
    }
    lookAgain();
  }

  function lookAgain() {
    counting.now();
    list.now();
  }
}

/** Retry all jobs of a list, page by page, and report the outcome. */
async function retryEach(path, wanted, signal) {
  let after = 0;
  let back = 0;
  let refused = 0;
  let reason = "";
  while (after !== null) {
    const page = await get(path(after), { signal });
    for (const job of page.jobs.filter(wanted)) {
      try {
        await send("POST", `jobs/${job.id}/retry`, { signal });
        back += 1;
      } catch (error) {
        if (!(error instanceof ApiError) || error.status !== 409) throw error;
        refused += 1;
        reason = error.message;
      }
    }
    after = page.next;
  }
  if (back) toast(`${plural(back, "job")} ${back === 1 ? "is" : "are"} back in the queue.`);
  if (refused) toast(`${plural(refused, "job")} cannot be retried. Last error: ${reason}`, { bad: true });
}

/** Return the state to show first: jobs that can be retried, then running and queued ones, then the rest. */
function firstLook(counts) {
  if (retriable(counts) > 0) return "quarantined";
  return ["leased", "queued"].find((status) => howMany(counts, status) > 0) ?? "quarantined";
}

/** Return the number of jobs in quarantine that can be retried. */
function retriable(counts, campaign = "") {
  return rowsOf(counts, "status").reduce((total, row) => total
    + (row.status === "quarantined" && (!campaign || row.campaign === campaign) && isAwaited(row, counts) ? row.jobs : 0), 0);
}

function isAwaited({ campaign, kind }, counts) {
  return kind === "trace" || !counts.ended.includes(campaign);
}

function howMany(counts, status, campaign = "") {
  return rowsOf(counts, "status").reduce(
    (total, row) => total + (row.status === status && (!campaign || row.campaign === campaign) ? row.jobs : 0), 0);
}

/** Return the parts of the page, and functions that update them. */
function pageOf(context, choose, retry, retryAll) {
  const states = segments("State", (status) => choose({ status }));
  const campaigns = h("select", { onchange: () => choose({ campaign: campaigns.value }) });
  const all = h("button", { type: "button", hidden: true, onclick: retryAll });
  const body = h("tbody");
  const caption = h("caption.read-out");
  const first = h("button", { type: "button", hidden: true, onclick: () => choose({ after: 0 }) }, "First");
  const further = h("button", { type: "button", hidden: true }, "Next");
  let next = null;
  further.addEventListener("click", () => choose({ after: next }));
  const shown = h("p.hint", { role: "status" });
  const hint = h("p.hint");
  const empty = h("p.empty", { hidden: true });
  const notes = h("div");
  const table = h("div.card.scroll", { tabindex: 0, role: "region", "aria-label": "Jobs", hidden: true }, h("table.jobs", null, caption,
    h("thead", null, h("tr", null, ["Job", "Solution", "Needs", "Attempts", "Since"].map((words) => h("th", { scope: "col" }, words)),
      h("th.worker", { scope: "col" }, "Worker"), h("th.errors", { scope: "col" }, "Last error"), h("th.again", { scope: "col" }, h("span.read-out", null, "Actions")))), body));
  const filters = h("div.inline.filters", null, states, h("label", null, "Campaign ", campaigns), all);

  function tally(counts, chosen) {
    states.update(STATUSES.map((status) => [status, `${WORDS[status]} ${count(howMany(counts, status, chosen.campaign))}`]), chosen.status);
    const known = { ...counts.campaigns, ...(chosen.campaign && !(chosen.campaign in counts.campaigns) ? { [chosen.campaign]: chosen.campaign } : {}) };
    const options = [["", "all"], ...Object.entries(known).sort((a, b) => a[1].localeCompare(b[1]))];
    keyed(campaigns, options, ([id]) => id, ([id, name]) => h("option", { value: id }, id && name !== id ? `${name} (${id})` : name));
    if (campaigns.value !== chosen.campaign) campaigns.value = chosen.campaign;
    const many = retriable(counts, chosen.campaign);
    all.hidden = !(context.may.steer && chosen.status === "quarantined" && many > 0);
    text(all, `Retry all ${count(many)} listed`);
    text(hint, HINTS[chosen.status]);
    notice(notes, counts);
  }

  function list(jobs, counts, chosen, following, { waiting = false } = {}) {
    const now = serverNow();
    keyed(body, jobs.map((job) => ({ ...job, name: counts.campaigns[job.campaign] ?? job.campaign, awaited: isAwaited(job, counts), now })), (job) => job.id,
      (job) => jobRow(job, context.may.steer, retry));
    text(caption, `Jobs with the status ${chosen.status}, by id`);
    table.hidden = jobs.length === 0;
    for (const [part, is] of [["leased", chosen.status === "leased"], ["erred", jobs.some((job) => job.last_error)], ["quarantined", chosen.status === "quarantined"]]) {
      table.classList.toggle(part, is);
    }
    empty.hidden = jobs.length > 0 || waiting;
    text(empty, chosen.after ? "No more jobs." : `No job is ${chosen.status === "quarantined" ? "in quarantine" : chosen.status}.`);
    next = following;
    further.hidden = following === null;
    first.hidden = chosen.after === 0;
    text(shown, jobs.length ? `${count(jobs.length)} shown` : "");
  }

  return { notes, filters, hint, table, empty, pages: h("div.inline.pages", null, first, further, shown), tally, list };
}

function notice(place, counts) {
  const waits = waitsFor(counts);
  const waiting = counts.paused.map((id) => [id, howMany(counts, "queued", id)]);
  const told = JSON.stringify([counts.unrunnable, waiting]);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place,
    waits && callout("warn", "No live worker can run all jobs: ", waits, "Start one: ", workerCommand()),
    waiting.map(([id, jobs]) => callout("", h("a", { href: link("campaigns", id) }, counts.campaigns[id]),
      ` is paused: ${plural(jobs, "queued job")} ${jobs === 1 ? "waits" : "wait"} until it is resumed.`)));
}

function jobRow(first, steer, retry) {
  const campaign = h("a", { href: link("campaigns", first.campaign) });
  const attempts = h("td");
  const worker = h("td.worker.mono.small");
  const since = h("td.small", { title: when(first.created_at) });
  const brief = h("summary");
  const whole = h("pre.error", { tabindex: 0, role: "region", "aria-label": `Last error of job ${first.id}` });
  const error = h("details", null, brief, whole);
  const again = h("button", { type: "button", "aria-label": `Retry job ${first.id}`, onclick: async () => {
    again.disabled = true;
    await retry(first);
    again.disabled = false;
  } }, "Retry");
  const ended = h("span.small.muted", null, "its campaign has ended");
  const node = h("tr", null, h("th.figure", { scope: "row" }, String(first.id)),
    h("td.of", null, KINDS[first.kind] ?? `${first.kind} of `, h("a", { href: link("campaigns", first.campaign, "solutions", first.number) }, `solution ${first.number}`), " of ", campaign),
    h("td.mono.small", null, first.needs), attempts, since, worker, h("td.errors", null, error), h("td.again", null, again, ended));
  node.update = (job) => {
    text(campaign, job.name);
    const losses = job.losses ? `, ${job.losses} of ${job.max_losses} lost` : "";
    text(attempts, `${job.counted_attempts} of ${job.max_attempts}${losses}`);
    text(worker, job.worker ?? "–");
    text(since, ago(job.finished_at ?? job.created_at, job.now));
    error.hidden = !job.last_error;
    text(brief, firstLine(job.last_error ?? ""));
    text(whole, job.last_error ?? "");
    again.hidden = !steer || job.status !== "quarantined" || !job.awaited;
    ended.hidden = job.status !== "quarantined" || job.awaited;
  };
  node.update(first);
  return node;
}

function firstLine(words) {
  const [line] = words.trim().split("\n");
  return line.length > 90 ? `${line.slice(0, 90)}…` : line;
}
