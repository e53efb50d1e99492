/** The services of a view: requests, polling, access rights, messages. They end with the view. */

import { ApiError, get, send } from "./api.js";
import { h, replace } from "./dom.js";
import { poll } from "./polling.js";

/** One view's services. */
export class Context {
  #end = new AbortController();
  /** Aborted when the view is left or replaced by an error. */
  signal = this.#end.signal;

  /**
   * @param {object} given
   * @param {AbortSignal} given.signal Aborted when the view is left.
   * @param {{steer: boolean, remove: boolean, operate: boolean}} given.may What the scope of the token allows.
   * @param {Element} given.main Element that contains the view.
   * @param {(error: ApiError|null) => void} given.away Called with a temporary error, and with null after a response.
   * @param {() => void} given.signIn Shows the sign-in form.
   */
  constructor({ signal, may, main, away, signIn }) {
    signal.addEventListener("abort", () => this.#end.abort(), { signal: this.signal });
    /** Options for `withRetries` and `whenMade`. */
    this.retrying = { signal: this.signal, away };
    this.may = may;
    this.main = main;
    this.signIn = signIn;
  }

  /**
   * Return options for `whenMade` that have traces recorded if they are missing and the token allows it.
   *
   * @param {string} path Where to request that.
   */
  recording(path) {
    return { ...this.retrying, record: this.may.steer ? path : null };
  }

  /** Set the title of the page. */
  title(words) {
    document.title = `${words} · Brink`;
  }

  /** Poll a path while the view is shown; see `poll`. Unless `refuse` is given, a permanent error replaces the view. */
  watch(path, take, { busy, until, refuse = (error) => this.fail(error) } = {}) {
    const heard = (error) => (error.status === 401 ? this.signIn() : refuse(error));
    const signal = until ? AbortSignal.any([this.signal, until]) : this.signal;
    return poll(path, take, { ...this.retrying, signal, busy, refuse: heard });
  }

  /** Return the JSON content of a path. */
  async get(path) {
    const told = await get(path, { signal: this.signal });
    this.retrying.away(null);
    return told;
  }

  /** Send a request, confirm it with a message, and return the response; after an error, show it and return undefined. */
  async act(method, path, said, options = {}) {
    return this.tell(async () => {
      const answer = await send(method, path, options);
      this.retrying.away(null);
      if (said) toast(said);
      return answer;
    });
  }

  /** Run an action of the view; errors are shown as messages, and the view stays. */
  async tell(doing) {
    try {
      return await doing();
    } catch (error) {
      if (!(error instanceof ApiError)) {
        if (this.signal.aborted) return undefined;
        throw error;
      }
      if (error.status === 401) this.signIn();
      else toast(error.message, { bad: true });
      return undefined;
    }
  }

  /** Show an error in a part of the view as a message, once. */
  complain = (error) => {
    if (error.status === 401) this.signIn();
    else if (!this.#complained.has(error.message)) toast(error.message, { bad: true });
    this.#complained.add(error.message);
  };

  #complained = new Set();

  /** Replace the view by an error. */
  fail(error) {
    if (this.signal.aborted) return;
    const heading = error.status === 404 ? "Not found" : "This page cannot be shown";
    this.#end.abort(); // stops everything else in the view
    replace(this.main, h("div.empty", null, h("h1", null, heading), h("p", null, error.message),
      h("p", null, h("a", { href: "#/" }, "All campaigns"))));
  }
}

/** Show a message for a few seconds; errors stay until they are dismissed. */
export function toast(words, { bad = false } = {}) {
  const node = h(`div.toast${bad ? ".bad" : ""}`, null, h("span", null, words),
    h("button.quiet", { type: "button", "aria-label": "Dismiss", onclick: () => node.remove() }, "×"));
  document.getElementById("toasts").append(node);
  if (!bad) setTimeout(() => node.remove(), 5_000);
}
