/** The time that is shown, and how it goes on: played, sought, stepped. Everything that moves listens to it. */

const LONGEST_FRAME_S = 0.1;
/** A page that was hidden goes on where it was, instead of jumping. */

/** Plays an episode. */
export class Player {
  #listeners = [];
  #frame = null;
  #drawn_ms = 0;

  /**
   * @param {import("./episode.js").Episode} episode
   * @param {AbortSignal} signal Ends it.
   */
  constructor(episode, signal) {
    this.episode = episode;
    this.time_s = episode.start_s;
    this.sample = 0;
    this.speed = 1;
    this.signal = signal;
    signal.addEventListener("abort", () => this.pause(), { once: true });
  }

  get playing() {
    return this.#frame !== null;
  }

  /**
   * Have a function called whenever something changes: with the player, and what changed: ``time``, ``sample`` too if it is
   * another one, or ``state``. It is called at once, as if all had changed.
   */
  listen(listener) {
    this.#listeners.push(listener);
    listener(this, { time: true, sample: true, state: true });
  }

  /** Go to a time. */
  seek(time_s) {
    const { episode } = this;
    this.time_s = Math.min(episode.end_s, Math.max(episode.start_s, time_s));
    const sample = episode.sampleAt(this.time_s);
    const other = sample !== this.sample;
    this.sample = sample;
    this.#tell({ time: true, sample: other });
  }

  /** Go to a sample. */
  show(sample) {
    this.seek(this.episode.times[Math.min(this.episode.last, Math.max(0, sample))]);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Go on, from the beginning if it is at the end. */
  play() {
    if (this.playing || this.signal.aborted) return;
    if (this.time_s >= this.episode.end_s) this.seek(this.episode.start_s);
    this.#drawn_ms = performance.now();
    this.#frame = requestAnimationFrame((now) => this.#next(now));
    this.#tell({ state: true });
  }

  pause() {
    if (!this.playing) return;
    cancelAnimationFrame(this.#frame);
    this.#frame = null;
    this.#tell({ state: true });
  }

  setSpeed(speed) {
    this.speed = speed;
    this.#tell({ state: true });
  }

  #next(now_ms) {
    const passed_s = Math.min(LONGEST_FRAME_S, Math.max(0, (now_ms - this.#drawn_ms) / 1000));
    this.#drawn_ms = now_ms;
    this.seek(this.time_s + passed_s * this.speed);
    if (this.time_s >= this.episode.end_s) this.pause();
    else if (this.playing) this.#frame = requestAnimationFrame((now) => this.#next(now));
  }

  #tell(changed) {
    if (this.signal.aborted) return;
    for (const listener of this.#listeners) listener(this, changed);
  }
}
