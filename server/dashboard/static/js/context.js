/** What a view gets: where to ask, what it may do, how to say that something went wrong. It ends with the view. */

import { ApiError, get, send } from "./api.js";
import { h, replace } from "./dom.js";
import { poll } from "./poll.js";

/** One view's services. */
export class Context {
  #end = new AbortController();
  /** Aborted when the view is left, or an error has taken its place. */
  signal = this.#end.signal;

  /**
   * @param {object} given
   * @param {AbortSignal} given.signal Aborted when the view is left.
   * @param {{steer: boolean, remove: boolean}} given.may What the token's scope allows.
   * @param {Element} given.main Where the view is.
   * @param {(error: ApiError|null) => void} given.away Told what keeps answers away, and null once there is one.
   * @param {() => void} given.signIn Asks for a token.
   */
  constructor({ signal, may, main, away, signIn }) {
    signal.addEventListener("abort", () => this.#end.abort(), { signal: this.signal });
    /** What `patiently` and `whenMade` need. */
    this.patience = { signal: this.signal, away };
    this.may = may;
    this.main = main;
    this.signIn = signIn;
  }

  /** Name the view: the page's title, and what is read out. */
  title(words) {
    document.title = `${words} · Brink`;
  }

  /** Poll a path while the view is there; see `poll`. A refusal takes the view's place unless `refuse` is given. */
  watch(path, take, { busy, until, refuse = (error) => this.fail(error) } = {}) {
    const heard = (error) => (error.status === 401 ? this.signIn() : refuse(error));
    const signal = until ? AbortSignal.any([this.signal, until]) : this.signal;
    return poll(path, take, { ...this.patience, signal, busy, refuse: heard });
  }

  /** Return what a path holds. */
  async get(path) {
    const told = await get(path, { signal: this.signal });
    this.patience.away(null);
    return told;
  }

  /** Do something, say so, and return what was answered; undefined if it was refused, which is said too. */
  async act(method, path, said, options = {}) {
    return this.tell(async () => {
      const answer = await send(method, path, options);
      this.patience.away(null);
      if (said) toast(said);
      return answer;
    });
  }

  /** Do something small of the view; its error is said, and the view stays. */
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

  /** Say what a part of the view cannot show, once. */
  complain = (error) => {
    if (error.status === 401) this.signIn();
    else if (!this.#complained.has(error.message)) toast(error.message, { bad: true });
    this.#complained.add(error.message);
  };

  #complained = new Set();

  /** Show an error in place of the view. */
  fail(error) {
    if (this.signal.aborted) return;
    const heading = error.status === 404 ? "Not here" : "This cannot be shown";
    this.#end.abort(); // nothing else of the view goes on
    replace(this.main, h("div.empty", null, h("h1", null, heading), h("p", null, error.message),
      h("p", null, h("a", { href: "#/" }, "All campaigns"))));
  }
}

/** Say something for a few seconds; what is bad stays until it is put away. */
export function toast(words, { bad = false } = {}) {
  const node = h(`div.toast${bad ? ".bad" : ""}`, null, h("span", null, words),
    h("button.quiet", { type: "button", "aria-label": "Put away", onclick: () => node.remove() }, "×"));
  document.getElementById("toasts").append(node);
  if (!bad) setTimeout(() => node.remove(), 5_000);
}
