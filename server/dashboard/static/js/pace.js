/** How fast a count grows, by what was seen of it in the last minute. */

const OVER_MS = 60_000;
const EVERY_MS = 5_000;
const LEAST_MS = 10_000;

/** What was seen of one count. */
export class Pace {
  #seen = []; // of [when, how many], some seconds apart
  #count = 0;

  /** Take what the count is now. */
  note(count, nowMs) {
    if (count < this.#count) this.#seen = []; // somebody else with the same name
    this.#count = count;
    if (!this.#seen.length || nowMs - this.#seen.at(-1)[0] >= EVERY_MS) this.#seen.push([nowMs, count]);
    while (this.#seen.length > 2 && nowMs - this.#seen[1][0] > OVER_MS) this.#seen.shift();
  }

  /** Return how many came a second, or null while too little was seen. */
  perSecond(nowMs) {
    const [since, before] = this.#seen[0] ?? [nowMs, 0];
    return nowMs - since < LEAST_MS ? null : (this.#count - before) / ((nowMs - since) / 1000);
  }
}
