/** Loading what takes a while: only when there is news, and never so often that it is all that is done. */

import { ApiError } from "./api.js";
import { seen } from "./seen.js";

/**
 * Return a function to be told of news; it loads as soon as it may.
 *
 * @param {() => Promise<void>} load Loads and shows.
 * @param {{signal: AbortSignal, refuse: (error: ApiError) => void, leastMs?: number, share?: number}} options ``share`` of the
 *   time at most is spent loading; ``refuse`` hears of what cannot be loaded at all.
 */
export function sparing(load, { signal, refuse, leastMs = 1_000, share = 0.1 }) {
  let known;
  let wanted;
  let under_way = false;
  let notBefore = 0;
  let timer = null;

  async function run() {
    clearTimeout(timer);
    if (signal.aborted || under_way || wanted === known) return;
    const now = performance.now();
    if (document.hidden) {
      seen(signal).then(run);
      return;
    }
    if (now < notBefore) {
      timer = setTimeout(run, notBefore - now);
      return;
    }
    under_way = true;
    const loading = wanted;
    try {
      await load();
      known = loading;
    } catch (error) {
      if (signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      // Polling says that the coordinator is away; what failed then is loaded again, what is refused is not.
      if (!error.passes) {
        known = loading;
        refuse(error);
      }
    } finally {
      under_way = false;
      notBefore = performance.now() + Math.max(leastMs, (performance.now() - now) / share);
    }
    run();
  }

  signal.addEventListener("abort", () => clearTimeout(timer), { once: true });
  return (news, { atOnce = false } = {}) => {
    wanted = news;
    if (atOnce) [notBefore, known] = [0, undefined];
    run();
  };
}
