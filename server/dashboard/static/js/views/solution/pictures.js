/** The pictures of a film: fetched when they are wanted, a few ahead, and only so many kept. */

import { ApiError, request } from "../../api.js";

const KEPT = 60;
const AHEAD = 12;
const AT_ONCE = 4;
const AWAY_MS = 3_000;

/** Fetches the pictures of one film. */
export class Pictures {
  #bitmaps = new Map(); // by index, the one used last at the end
  #under_way = new Set();
  #wanted = [];
  #missing = new Set();

  /**
   * @param {string} path Of the solution.
   * @param {number} count How many pictures there are.
   * @param {() => void} came Called when one came.
   * @param {AbortSignal} signal Ends it.
   */
  constructor(path, count, came, signal) {
    this.path = path;
    this.count = count;
    this.came = came;
    this.signal = signal;
    signal.addEventListener("abort", () => {
      for (const bitmap of this.#bitmaps.values()) bitmap.close();
      this.#bitmaps.clear();
    }, { once: true });
  }

  /** Return a picture if it is there; if not, it is fetched, and so are those that follow it. */
  at(index) {
    const found = this.#bitmaps.get(index) ?? null;
    if (found) {
      this.#bitmaps.delete(index);
      this.#bitmaps.set(index, found);
    }
    this.#wanted = [];
    for (let next = index; next <= Math.min(this.count - 1, index + AHEAD); next += 1) {
      if (!this.#bitmaps.has(next) && !this.#under_way.has(next) && !this.#missing.has(next)) this.#wanted.push(next);
    }
    this.#fetch();
    return found;
  }

  /** Return a picture if it is there; nothing is fetched. */
  kept(index) {
    return this.#bitmaps.get(index) ?? null;
  }

  /** Whether a picture cannot be had. */
  isMissing(index) {
    return this.#missing.has(index);
  }

  #fetch() {
    while (this.#under_way.size < AT_ONCE && this.#wanted.length && !this.signal.aborted) this.#load(this.#wanted.shift());
  }

  async #load(index) {
    this.#under_way.add(index);
    try {
      const answer = await request("GET", `${this.path}/pictures/${index}.jpg`, { signal: this.signal });
      const bitmap = await createImageBitmap(await answer.blob());
      if (this.signal.aborted) {
        bitmap.close();
        return;
      }
      this.#bitmaps.set(index, bitmap);
      for (const [oldest, old] of this.#bitmaps) {
        if (this.#bitmaps.size <= KEPT) break;
        old.close();
        this.#bitmaps.delete(oldest);
      }
    } catch (error) {
      if (this.signal.aborted) return;
      // What will not come is not asked for again; what may, is looked for in a while.
      if (error instanceof ApiError && error.passes) {
        setTimeout(this.came, AWAY_MS);
        return;
      }
      this.#missing.add(index);
    } finally {
      this.#under_way.delete(index);
      this.#fetch();
    }
    this.came();
  }
}
