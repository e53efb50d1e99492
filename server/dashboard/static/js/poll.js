/** Polling: every 2 s while something goes on, every 10 s while not, never while nobody looks. */

import { ApiError, Conditional, UNCHANGED } from "./api.js";

const BUSY_MS = 2_000;
const IDLE_MS = 10_000;
const AWAY_MS = 3_000;

/**
 * Ask for a path again and again, until the signal says stop.
 *
 * @param {string | (() => string)} path What to ask for; a function says it anew each time.
 * @param {(read: *) => void} take Called with each answer that is new.
 * @param {object} options
 * @param {AbortSignal} options.signal Ends it.
 * @param {(read: *) => boolean} [options.busy] Whether to look often, by the last answer.
 * @param {(error: ApiError) => void} options.refuse Called with an error that will not pass.
 * @param {(error: ApiError|null) => void} options.away Called with an error that will pass, and with null at each answer.
 * @returns {{now: (options?: {afresh: boolean}) => void}} Something that looks at once; ``afresh``, even if nothing is new.
 */
export function poll(path, take, { signal, busy = () => false, refuse, away }) {
  const conditional = new Conditional();
  let last;
  let timer = null;
  let under_way = false;
  let again = false;
  let fresh = false;

  async function look({ afresh = false } = {}) {
    fresh ||= afresh;
    clearTimeout(timer);
    if (signal.aborted) return;
    if (under_way) {
      again = true;
      return;
    }
    if (document.hidden) return; // `shown` looks again
    under_way = true;
    if (fresh) conditional.forget();
    fresh = false;
    let wait = IDLE_MS;
    try {
      const read = await conditional.get(typeof path === "function" ? path() : path, { signal });
      if (signal.aborted) return;
      away(null);
      if (read !== UNCHANGED) {
        last = read;
        take(read);
      }
      if (last !== undefined && busy(last)) wait = BUSY_MS;
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (!error.passes) {
        refuse(error);
        return;
      }
      away(error);
      wait = AWAY_MS;
    } finally {
      under_way = false;
    }
    timer = setTimeout(() => look(), again ? 0 : wait);
    again = false;
  }

  function shown() {
    if (!document.hidden) look();
  }

  document.addEventListener("visibilitychange", shown, { signal });
  signal.addEventListener("abort", () => clearTimeout(timer), { once: true });
  look();
  return { now: look };
}
