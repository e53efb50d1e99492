/** The frame around the views: navigation, sign-in, and notices when the coordinator is away. */

import { ApiError, currentToken, dropToken, get, rights } from "./api.js";
import { Context } from "./context.js";
import { attribute, h, replace, text } from "./dom.js";
import { sentence } from "./format.js";
import { seen } from "./polling.js";
import { place } from "./router.js";
import { chosen, turn } from "./theme.js";

const NAV = [
  ["#/", "Campaigns", ["", "campaigns", "new"]],
  ["#/compare", "Compare", ["compare"]],
  ["#/experiments", "Experiments", ["experiments"]],
  ["#/workers", "Workers", ["workers"]],
  ["#/jobs", "Jobs", ["jobs"]],
];

const AWAY_MS = 3_000;
const AWAY = { 0: "The coordinator does not respond.", 429: "Rate limit exceeded." };

const main = document.getElementById("main");
const notice = document.getElementById("notice");
let shown = null; // ends the current view
let access = null; // what the token may do

/** Import the module of a view; null if there is no such view. */
function viewOf(parts) {
  const [first = "campaigns", id, part, number] = parts;
  if (first === "campaigns" && !id) return import("./views/campaigns.js");
  if (first === "campaigns" && !part) return import("./views/campaign.js");
  if (first === "campaigns" && part === "solutions" && /^\d+$/.test(number ?? "")) return import("./views/solution.js");
  if (first === "campaigns" && part === "pairs" && number === undefined) return import("./views/pairs.js");
  if (first === "campaigns" && part === "pairs" && /^\d+-\d+$/.test(number)) return import("./views/pair.js");
  if (first === "campaigns" && part === "versions") return import("./views/versions.js");
  if (first === "new") return import("./views/new_campaign.js");
  if (first === "compare") return import("./views/compare.js");
  if (first === "experiments") return id ? import("./views/experiment.js") : import("./views/experiments.js");
  if (first === "workers") return import("./views/workers.js");
  if (first === "jobs") return import("./views/jobs.js");
  return null;
}

let retrying = null;

async function show({ focus = true } = {}) {
  shown?.abort();
  clearTimeout(retrying);
  const mine = (shown = new AbortController());
  const where = place();
  markNav(where.parts[0] ?? "");
  if (access === null && !(await identify(mine.signal))) return;
  if (mine.signal.aborted) return;
  const context = new Context({
    signal: mine.signal, may: rights(access.scope), main, away: sayAway, signIn: () => signIn("This token is no longer valid."),
  });
  const loading = viewOf(where.parts);
  if (loading === null) {
    context.title("Not found");
    context.fail(new ApiError(404, "There is no such page."));
    return;
  }
  try {
    const view = await loading;
    if (mine.signal.aborted) return;
    replace(main, h("p.loading", { role: "status" }, "Loading …")); // replaced by the view
    window.scrollTo(0, 0);
    await view.show(main, context, where);
    if (focus && !mine.signal.aborted) main.focus({ preventScroll: true });
  } catch (error) {
    if (context.signal.aborted) return;
    const told = error instanceof ApiError;
    if (told && error.status === 401) signIn("This token is no longer valid.");
    else if (told && !error.passes) context.fail(error);
    else if (told) tryAgain(error);
    else if (error instanceof TypeError) tryAgain(new ApiError(0, "")); // the module could not be fetched
    else throw error;
  }
}

/** Show that the coordinator is away, and load the view again later. */
function tryAgain(error) {
  sayAway(error);
  clearTimeout(retrying);
  const { signal } = shown;
  retrying = setTimeout(() => seen(signal).then(() => signal.aborted || show()), AWAY_MS);
}

/** Read the access rights, and ask for a token if needed. Returns whether the view can be shown. */
async function identify(signal) {
  try {
    access = await get("access", { signal });
    sayAway(null);
  } catch (error) {
    if (signal.aborted) return false;
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) {
      await signIn(currentToken() ? "Token rejected." : "");
    } else if (error.status === 403 && currentToken()) {
      await signIn("This is a worker token, which can only lease jobs. Use a token of scope read, user or admin.");
    } else if (error.passes) {
      tryAgain(error);
    } else {
      const context = new Context({ signal: shown.signal, may: rights(""), main, away: sayAway, signIn: () => signIn("") });
      context.title("No access");
      context.fail(error);
    }
    return false;
  }
  drawTools();
  return true;
}

async function signIn(reason) {
  access = null;
  shown?.abort();
  shown = new AbortController();
  dropToken();
  drawTools();
  const { show: ask } = await import("./views/sign_in.js");
  ask(main, { reason, signal: shown.signal, done: () => show() });
}

function markNav(first) {
  for (const [index, item] of [...document.querySelectorAll("#nav a")].entries()) {
    attribute(item, "aria-current", NAV[index][2].includes(first) ? "page" : null);
  }
}

function drawTools() {
  const words = { system: "Theme: system", light: "Theme: light", dark: "Theme: dark" };
  const theme = h("button.quiet", { type: "button", onclick: () => text(theme, words[turn()]) }, words[chosen()]);
  const scope = access?.tokens ? h("span.scope", { title: "Scope of this token" }, `scope ${access.scope}`) : null;
  const out = access?.tokens
    ? h("button.quiet", { type: "button", onclick: () => signIn("") }, "Sign out")
    : null;
  replace(document.getElementById("tools"), scope, h("a.quiet", { href: "docs" }, "API"), theme, out);
}

/** Show why there is no response, until there is one. */
function sayAway(error) {
  const words = error && `${AWAY[error.status] ?? sentence(error.message)} Retrying; the page keeps what it shows.`;
  if (notice.textContent === (words ?? "")) return;
  notice.hidden = !words;
  replace(notice, words && h("p.away", null, words));
}

replace(document.getElementById("nav"), NAV.map(([href, words]) => h("a", { href }, words)));
notice.hidden = true;
drawTools();
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault(); // #main is not a place
  main.focus();
});
addEventListener("hashchange", () => show());
show({ focus: false });
