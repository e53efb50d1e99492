/** What is known of a campaign that is compared: itself, its course so far, and its scores once it has ended. */

import { ApiError, get, request } from "../../api.js";
import { poll } from "../../poll.js";

const OPEN = new Set(["running", "paused"]);
const LOOK_AGAIN_MS = 2_000;

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
    if (!OPEN.has(read.status) && !followed.scores && !followed.scoring) score(followed, path, own.signal, changed, refuse);
    changed();
  }

  get(path, { signal: own.signal }).then((campaign) => {
    followed.campaign = campaign;
    const since = () => (followed.generations.at(-1)?.number ?? -1) + 1;
    poll(() => `${path}/progress?since=${since()}`, take,
      { signal: own.signal, busy: (read) => read.status === "running", refuse, away: context.away });
    changed();
  }).catch(refuse);
  return followed;
}

async function score(followed, path, signal, changed, refuse) {
  followed.scoring = "being scored";
  while (!signal.aborted) {
    try {
      const answer = await request("GET", `${path}/scores?wait_s=5`, { signal });
      const read = await answer.json();
      if (answer.status !== 202) {
        Object.assign(followed, { scores: read, scoring: "" });
        changed();
        return;
      }
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof ApiError) || error.status === 401) return void refuse(error);
      if (!error.passes) {
        followed.scoring = "cannot be scored";
        followed.trouble = error.message;
        changed();
        return;
      }
    }
    await new Promise((resolve) => setTimeout(resolve, LOOK_AGAIN_MS));
  }
}
