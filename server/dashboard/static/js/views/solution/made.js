/** Gets an episode: waits while a worker makes it, says when nobody can, and asks again. */

import { ApiError } from "../../api.js";
import { h, replace } from "../../dom.js";
import { sentence } from "../../format.js";
import { whenMade } from "../../polling.js";
import { callout, workerCommand } from "../../parts/elements.js";

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

  async function ask() {
    say(h("p", null, "Asking for the episode …"));
    try {
      const told = await whenMade(`${path}/episode`, { ...context.retrying, making });
      node.remove();
      take(told);
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) context.signIn();
      else refused(error);
    }
  }

  function making() {
    say(h("p", null, "Its trace was not kept: a worker simulates the episode again, exactly as it was. This takes a few seconds once a worker is free."));
  }

  function refused(error) {
    const retry = h("button", { type: "button", onclick: ask }, "Try again");
    if (error.noWorker) {
      say(callout("warn", h("p", null, `To be shown, the episode must be simulated again. ${sentence(error.message)}`),
        h("p", null, "Start a worker: ", workerCommand())), retry);
    } else {
      say(callout("", `There is no replay. ${sentence(error.message)}`), error.status === 409 && retry);
    }
  }

  ask();
  return node;
}
