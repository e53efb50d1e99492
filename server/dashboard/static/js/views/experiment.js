/** One experiment: where it stands, what can be done with it, what it found, its campaigns. */

import { ApiError } from "../api.js";
import { h, keyed, replace, text } from "../dom.js";
import { capital, count, percent, plural, rate, span, when } from "../format.js";
import { badge } from "../parts/badge.js";
import { callout } from "../parts/callout.js";
import { sure } from "../parts/confirm.js";
import { facts } from "../parts/facts.js";
import { meter } from "../parts/meter.js";
import { go, link } from "../router.js";
import { whenMade } from "../patience.js";
import { isOpen } from "../status.js";
import { resultsSection } from "./experiment/results.js";

export async function show(main, context, { parts: [, id], query }) {
  context.title("Experiment");
  const path = `experiments/${encodeURIComponent(id)}`;
  const name = h("h1", null, "Experiment");
  const state = badge("pending", "");
  const actions = h("div.actions.push");
  const done = meter("Simulations");
  const told = facts();
  const notes = h("div");
  const scoring = h("p.scoring", { role: "status" });
  const results = resultsSection(context, query);
  const members = membersTable();
  replace(main, h("p.crumb", null, h("a", { href: link("experiments") }, "Experiments")),
    h("div.head", null, name, state, actions), notes,
    h("div.stack", null, h("section.card.standing", { "aria-label": "Where it stands" }, done, told), scoring, results,
      h("section.card", { "aria-labelledby": "members" }, h("h2", { id: "members" }, "Campaigns"), members)));

  const loading = resultsOf(path, context, scoring, results.update);
  let whole = null;
  const looking = context.watch(path, (read) => {
    whole = read;
    context.title(read.name);
    text(name, read.name);
    members.update(read.members);
  }, { busy: (read) => read.status === "running" });
  let drawn = null;
  const progressing = context.watch(`${path}/progress`, (read) => {
    state.update(read.status);
    done.update(read.budget ? read.simulations / read.budget : 0, !isOpen(read.status));
    told.update(figuresOf(read));
    warn(notes, read);
    const may = JSON.stringify([read.status, read.paused.length > 0]);
    if (drawn !== may) {
      drawn = may;
      replace(actions, steering(read, context, path, () => {
        looking.now();
        progressing.now();
      }));
    }
    loading.want(read.finished);
  }, { busy: (read) => read.status === "running" });
}

function figuresOf(read) {
  const open = isOpen(read.status);
  return {
    "Campaigns finished": `${count(read.finished)} of ${count(read.campaigns)}`,
    Simulations: `${count(read.simulations)} of ${count(read.budget)}`,
    Failed: count(read.failed),
    ...(open ? { "Time left": span(read.remaining_s), Queued: count(read.queued), Leased: count(read.leased), "Live workers": count(read.workers) } : {}),
    ...(read.deleted ? { Deleted: count(read.deleted) } : {}),
    ...(read.quarantined ? { "In quarantine": count(read.quarantined) } : {}),
    Rate: rate(read.rate_per_s), [open ? "So far" : "Took"]: span(read.elapsed_s), Submitted: when(read.created_at),
  };
}

function warn(place, read) {
  const told = JSON.stringify([read.paused, read.trouble, read.status === "running" && read.workers === 0]);
  if (place.dataset.told === told) return;
  place.dataset.told = told;
  replace(place,
    read.trouble && callout("bad", `The database takes no writes now: ${read.trouble}. Nothing that was acknowledged is lost.`),
    read.status === "running" && read.workers === 0 && callout("warn", "It is running, but no worker is there. ", h("a", { href: link("workers") }, "How to start one")),
    read.paused.length > 0 && callout("warn", `${plural(read.paused.length, "campaign")} ${read.paused.length === 1 ? "is" : "are"} paused:`,
      h("ul.reasons", null, pausedFor(read.paused).map(([reason, ids]) => h("li", null, `${reason}: `,
        ids.map((id, index) => [index > 0 && ", ", h("a", { href: link("campaigns", id) }, id)]))))));
}

/** Return the reasons for which campaigns are paused, each with their ids. */
function pausedFor(told) {
  const found = new Map();
  for (const one of told) {
    const [id, ...rest] = one.split(": ");
    const reason = rest.join(": ");
    found.set(reason, [...(found.get(reason) ?? []), id]);
  }
  return [...found];
}

function steering(read, context, path, look) {
  const act = async (method, way, said) => {
    const answer = await context.act(method, path + way, said);
    look();
    return answer;
  };
  const button = (words, doing, kind) => h(kind ? `button.${kind}` : "button", { type: "button", onclick: doing }, words);
  const open = isOpen(read.status);
  return [
    context.may.steer && read.status === "running" && button("Pause", () => act("POST", "/pause", "The experiment is paused; what runs is still taken in.")),
    context.may.steer && read.paused.length > 0 && button("Resume", () => act("POST", "/resume", "The experiment goes on.")),
    context.may.steer && open && button("Cancel", async () => {
      if (await sure("Cancel the campaigns that have not ended? What they found stays; they cannot go on.", { yes: "Cancel them" })) await act("POST", "/cancel", "The experiment is cancelled.");
    }),
    h("a.button", { href: link("campaigns", { experiment: read.id }) }, "Its campaigns"),
    context.may.remove && !open && button("Delete", async () => {
      const question = `Delete ${read.name} with its ${plural(read.campaigns - read.deleted, "campaign")} and all that they found? This cannot be undone.`;
      if ((await sure(question, { yes: "Delete it" })) && (await context.act("DELETE", path, "The experiment is deleted.")) === null) go("experiments");
    }, "danger"),
  ];
}

/** Read results again whenever more campaigns have finished, waiting while they are scored. */
function resultsOf(path, context, scoring, take) {
  let wanted = 0;
  let taken = 0;
  let under_way = false;

  async function look() {
    if (under_way || wanted === taken) return;
    under_way = true;
    const asked = wanted;
    try {
      const read = await whenMade(`${path}/results`, { ...context.patience, making, firstS: 2, waitS: 2 });
      text(scoring, "");
      take(read);
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) return void context.signIn();
      text(scoring, `Its results cannot be shown: ${error.message}`);
    } finally {
      under_way = false;
    }
    taken = asked;
    look();
  }

  function making({ detail }) {
    text(scoring, `${capital(detail)}; the tables come when all are.`);
  }

  return { want: (finished) => { wanted = finished; look(); } };
}

function membersTable() {
  const body = h("tbody");
  const node = h("div.scroll.members", { tabindex: 0, role: "region", "aria-label": "Campaigns of the experiment" }, h("table", null,
    h("caption.read-out", null, "Campaigns of the experiment"),
    h("thead", null, h("tr", null, ["Campaign", "Method", "Problem", "Status"].map((words) => h("th", { scope: "col" }, words)),
      ["Seed", "Simulations", "Unsafe", "Failed"].map((words) => h("th.right", { scope: "col" }, words)))), body));
  node.update = (members) => keyed(body, members, (one) => one.campaign, memberRow);
  return node;
}

function memberRow(first) {
  const state = badge(first.status);
  const reason = h("div.small.muted");
  const [seed, simulations, unsafe, failed] = Array.from({ length: 4 }, () => h("td.right"));
  const node = h("tr", null, h("th", { scope: "row" }, h("a", { href: link("campaigns", first.campaign) }, first.campaign)),
    h("td", null, first.method), h("td", null, first.problem), h("td", null, state, reason), seed, simulations, unsafe, failed);
  node.update = (one) => {
    state.update(one.status);
    text(reason, one.status_reason);
    text(seed, one.seed);
    text(simulations, count(one.simulations));
    text(unsafe, one.simulations > one.failed ? `${count(one.unsafe)} (${percent(one.unsafe / (one.simulations - one.failed))})` : "–");
    text(failed, count(one.failed));
  };
  node.update(first);
  return node;
}
