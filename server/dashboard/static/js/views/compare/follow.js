/** What is known of a campaign that is compared: itself, its course so far, and its scores once it has ended. */

import { ApiError, get } from "../../api.js";
import { poll } from "../../poll.js";
import { isOpen } from "../../status.js";
import { patiently, whenMade } from "../../patience.js";

/**
 * Follow a campaign until it is let go.
 *
 * @param {string} id
 * @param {object} context Of the view.
 * @param {() => void} changed Called whenever more is known.
 * @returns {object} ``id``, and as they come: ``campaign``, ``progress``, ``generations``, ``scores``, ``scoring`` (words), ``trouble``;
 *   ``leave()`` ends it.
 */
export function follow(id, context, changed) {
  const own = new AbortController();
  context.signal.addEventListener("abort", () => own.abort(), { signal: own.signal });
  const followed = { id, campaign: null, progress: null, generations: [], scores: null, scoring: "", trouble: "", leave: () => own.abort() };
  const path = `campaigns/${encodeURIComponent(id)}`;
  const patience = { ...context.patience, signal: own.signal };

  function refuse(error) {
    if (own.signal.aborted) return;
    if (!(error instanceof ApiError)) throw error;
    if (error.status === 401) return void context.signIn();
    followed.trouble = error.message;
    changed();
  }

  function take(read) {
    followed.progress = read;
    const [first] = read.generations;
    const known = first === undefined ? followed.generations : followed.generations.filter((one) => one.number < first.number);
    followed.generations = [...known, ...read.generations];
    if (!isOpen(read.status) && !followed.scores && !followed.scoring) score();
    changed();
  }

  async function score() {
    followed.scoring = "being scored";
    try {
      Object.assign(followed, { scores: await whenMade(`${path}/scores`, { ...patience, firstS: 3, waitS: 3 }), scoring: "" });
    } catch (error) {
      if (!own.signal.aborted) followed.scoring = "cannot be scored";
      refuse(error);
      return;
    }
    changed();
  }

  patiently(() => get(path, patience), patience).then((campaign) => {
    followed.campaign = campaign;
    const since = () => (followed.generations.at(-1)?.number ?? -1) + 1;
    poll(() => `${path}/progress?since=${since()}`, take,
      { ...patience, busy: (read) => read.status === "running", refuse });
    changed();
  }).catch(refuse);
  return followed;
}
