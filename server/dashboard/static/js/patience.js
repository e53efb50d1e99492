/** Asking until there is an answer: a coordinator may be away for a while, and some answers take time to make. */

import { ApiError, read, request } from "./api.js";
import { pause, seen } from "./seen.js";

const AGAIN_MS = 1_000;
const AWAY_MS = 3_000;

/**
 * @typedef {object} Patience
 * @property {AbortSignal} signal Ends it.
 * @property {(error: ApiError|null) => void} away Hears of each error that will pass, and null once there is an answer.
 * @property {(error: ApiError) => boolean} [passes] Whether to ask again after an error; all that pass, but for faults of the
 *   coordinator's own, which would only happen again, and if somebody must start a worker first.
 */

/**
 * Return what is answered, asking again after errors that will pass; nothing is asked while nobody looks.
 *
 * @param {() => Promise<*>} ask
 * @param {Patience} patience
 * @throws {ApiError} If it is refused; whatever aborting throws, once the signal is.
 */
export async function patiently(ask, { signal, away, passes = byItself }) {
  while (true) {
    await seen(signal);
    signal.throwIfAborted();
    try {
      const answer = await ask();
      away(null);
      return answer;
    } catch (error) {
      if (!(error instanceof ApiError) || !passes(error)) throw error;
      away(error);
    }
    await pause(AWAY_MS);
  }
}

function byItself(error) {
  return error.passes && error.status !== 500 && !error.noWorker;
}

/**
 * Return what a path holds once it is made: until then it is answered with 202.
 *
 * @param {string} path
 * @param {Patience & {making?: (told: object) => void, as?: "json" | "blob", firstS?: number, waitS?: number}} options
 *   ``making`` hears each time that it is not made yet; how long the coordinator may wait at first, and later: a browser
 *   has few connections, and who waits holds one.
 * @throws {ApiError} If it is refused; whatever aborting throws, once the signal is.
 */
export async function whenMade(path, { making = () => {}, as = "json", firstS = 0, waitS = 20, ...patience }) {
  let wait_s = firstS;
  async function ask() {
    const answer = await request("GET", `${path}?wait_s=${wait_s}`, patience);
    return answer.status === 202 ? { told: await read(answer) } : { made: await read(answer, as) };
  }
  while (true) {
    const { told, made } = await patiently(ask, patience);
    if (made !== undefined) return made;
    making(told);
    if (wait_s) await pause(AGAIN_MS);
    wait_s = waitS;
  }
}
