/** Gets an episode: waits while a worker makes it, says when nobody can, and asks again. */

import { ApiError, request } from "../../api.js";
import { h, replace } from "../../dom.js";
import { callout, workerCommand } from "../../parts/callout.js";

const WAIT_S = 20;
const AGAIN_MS = 2_000;
const AWAY_MS = 3_000;

/**
 * Return a place that says how far an episode is, and hands it on once it is there.
 *
 * @param {import("../../context.js").Context} context
 * @param {string} path Of the solution.
 * @param {(told: object) => void} take Called with the episode; the place is gone by then.
 */
export function made(context, path, take) {
  const words = h("div", { role: "status" });
  const node = h("section.card", { "aria-label": "Replay" }, h("h2", null, "Replay"), words);
  const say = (...what) => replace(words, what);
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

  async function ask() {
    let wait_s = 0;
    say(h("p", null, "Asking for the episode …"));
    while (!context.signal.aborted) {
      try {
        const answer = await request("GET", `${path}/episode?wait_s=${wait_s}`, { signal: context.signal });
        if (answer.status === 200) {
          const told = await answer.json();
          node.remove();
          take(told);
          return;
        }
        say(h("p", null, "Its trace was not kept: a worker simulates the episode again, exactly as it was. This takes a few seconds once a worker is free."));
        if (wait_s) await pause(AGAIN_MS);
        wait_s = WAIT_S;
      } catch (error) {
        if (context.signal.aborted) return;
        if (!(error instanceof ApiError)) throw error;
        if (error.status === 401) context.signIn();
        else if (error.status !== 0 && error.status !== 429) {
          refused(error);
          return;
        }
        await pause(AWAY_MS);
      }
    }
  }

  function refused(error) {
    const retry = h("button", { type: "button", onclick: ask }, "Try again");
    if (error.status === 503) {
      say(callout("warn", h("p", null, `To be shown, the episode must be simulated again. ${capital(error.message)}.`),
        h("p", null, "Start a worker: ", workerCommand())), retry);
    } else {
      say(callout("", `There is no replay: ${error.message}.`), error.status === 409 && retry);
    }
  }

  ask();
  return node;
}

function capital(words) {
  return words.charAt(0).toUpperCase() + words.slice(1);
}
