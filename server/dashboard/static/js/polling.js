/** Repeated requests: polling, loading new data at a bounded rate, and retrying until there is a response. Hidden pages send none. */

import { ApiError, Conditional, read, request, UNCHANGED } from "./api.js";

const BUSY_MS = 2_000;
const IDLE_MS = 10_000;
const AWAY_MS = 3_000;

/**
 * Poll a path until the signal is aborted: every 2 s while it is busy, otherwise every 10 s, never while the page is hidden.
 *
 * @param {string | (() => string)} path The path; a function is called before each request.
 * @param {(read: *) => void} take Called with each new response.
 * @param {object} options
 * @param {AbortSignal} options.signal Stops polling.
 * @param {(read: *) => boolean} [options.busy] Whether the last response calls for frequent polling.
 * @param {(error: ApiError) => void} options.refuse Called with a permanent error.
 * @param {(error: ApiError|null) => void} options.away Called with a temporary error, and with null after each response.
 * @returns {{now: (options?: {afresh: boolean}) => void}} ``now`` polls at once; with ``afresh``, ``take`` is called even if nothing is new.
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
    if (document.hidden) return; // `shown` polls again
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

/**
 * Return a function that loads when there is new data, as soon as the rate limit allows.
 *
 * @param {() => Promise<void>} load Loads and draws.
 * @param {{signal: AbortSignal, refuse: (error: ApiError) => void, leastMs?: number, share?: number}} options At most ``share``
 *   of the time is spent loading; ``refuse`` is called with a permanent error.
 */
export function loadOnNews(load, { signal, refuse, leastMs = 1_000, share = 0.1 }) {
  let known;
  let wanted;
  let under_way = false;
  let urgent = false; // asked for at once while an earlier one was loading
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
      // Polling reports that the coordinator is away. Temporary failures are loaded again, permanent ones are not.
      if (!error.passes) {
        known = loading;
        refuse(error);
      }
    } finally {
      under_way = false;
      notBefore = urgent ? 0 : performance.now() + Math.max(leastMs, (performance.now() - now) / share);
      if (urgent) known = undefined;
      urgent = false;
    }
    run();
  }

  signal.addEventListener("abort", () => clearTimeout(timer), { once: true });
  return (news, { atOnce = false } = {}) => {
    wanted = news;
    if (atOnce) [notBefore, known, urgent] = [0, undefined, under_way];
    run();
  };
}

const RETRY_MS = 1_000;

/**
 * @typedef {object} RetryOptions
 * @property {AbortSignal} signal Stops it.
 * @property {(error: ApiError|null) => void} away Called with each temporary error, and with null after a response.
 * @property {(error: ApiError) => boolean} [passes] Whether to retry after an error. By default all temporary errors, except
 *   internal errors of the coordinator, which would recur, and those that need a worker to be started first.
 */

/**
 * Return a response, retrying after temporary errors; hidden pages send no requests.
 *
 * @param {() => Promise<*>} ask
 * @param {RetryOptions} options
 * @throws {ApiError} On a permanent error; the abort error once the signal is aborted.
 */
export async function withRetries(ask, { signal, away, passes = isTemporary }) {
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

function isTemporary(error) {
  return error.passes && error.status !== 500 && !error.noWorker;
}

/**
 * Return the content of a path that is computed on demand and answered with 202 until then.
 *
 * @param {string} path
 * @param {RetryOptions & {making?: (told: object) => void, record?: string | null, as?: "json" | "blob", firstS?: number, waitS?: number}} options
 *   ``making`` is called with each 202 response. ``record`` is the path of a POST request that has what is missing
 *   recorded first; null if the token does not allow it. ``firstS`` and ``waitS`` are how long the coordinator may hold the first
 *   and later requests: a browser has few connections, and each pending request occupies one.
 * @throws {ApiError} On a permanent error; the abort error once the signal is aborted.
 */
export async function whenMade(path, { making = () => {}, record = null, as = "json", firstS = 0, waitS = 20, ...options }) {
  let wait_s = firstS;
  let asked = record === null;
  async function ask() {
    if (!asked) await request("POST", record, options);
    asked = true;
    const answer = await request("GET", `${path}?wait_s=${wait_s}`, options);
    return answer.status === 202 ? { told: await read(answer) } : { made: await read(answer, as) };
  }
  while (true) {
    const { told, made } = await withRetries(ask, options);
    if (made !== undefined) return made;
    making(told);
    if (wait_s) await pause(RETRY_MS);
    wait_s = waitS;
  }
}

/** Resolve once the page is visible: at once if it is, never if the signal is aborted first. */
export async function seen(signal) {
  while (document.hidden) {
    await new Promise((resolve) => document.addEventListener("visibilitychange", resolve, { once: true, signal }));
  }
}

/** Resolve after a delay. */
function pause(ms) {
  return new Promise((resolve) => setTimeout(resolve, ms));
}
