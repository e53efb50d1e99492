/** An episode as the API sends it, poses between its samples, and the player that every moving part of the page follows. */

const TELEPORT_M = 20;
/** No road user moves this far between two samples: a longer jump is not interpolated. */
const LONGEST_FRAME_S = 0.1;
/** Longest step of the clock: a page that was hidden goes on where it was instead of jumping. */

/** One episode. Samples are counted from 0; positions between two samples are interpolated. */
export class Episode {
  /** @param {object} data The response of ``GET …/episode``. */
  constructor(data) {
    this.data = data;
    this.times = data.time_s;
    this.last = this.times.length - 1;
    this.start_s = this.times[0];
    this.end_s = this.times[this.last];
    this.camera = data.camera;
    this.film = data.film;
    this.story = data.story;
    this.words = data.words;
  }

  /** Return the last sample that is not after a time. */
  sampleAt(time_s) {
    let low = 0;
    let high = this.last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time_s) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Return the sample before a time, and the share of the step to the next sample that has passed, in [0, 1]. */
  between(time_s) {
    const sample = this.sampleAt(time_s);
    if (sample >= this.last) return { sample, share: 0 };
    const step_s = this.times[sample + 1] - this.times[sample];
    return { sample, share: step_s > 0 ? Math.min(1, Math.max(0, (time_s - this.times[sample]) / step_s)) : 0 };
  }

  /** Return the pose of a track as ``{x, y, yaw}``; null where it is absent. */
  pose(track, { sample, share }) {
    const x = track.x_m[sample];
    const y = track.y_m[sample];
    const yaw = track.yaw_rad[sample];
    if (x === null || y === null || yaw === null) return null;
    const here = { x, y, yaw };
    const nextX = share > 0 ? track.x_m[sample + 1] : null;
    const nextY = share > 0 ? track.y_m[sample + 1] : null;
    if (nextX === null || nextY === null || Math.hypot(nextX - x, nextY - y) > TELEPORT_M) return here;
    here.x += share * (nextX - x);
    here.y += share * (nextY - y);
    here.yaw += share * shortestTurn(track.yaw_rad[sample + 1] - yaw);
    return here;
  }

  /** Return the entry for a label in one of the lists of words by label; their last entry is for any other label. */
  byLabel(list, label) {
    return this.words[list][label] ?? this.words[list].at(-1);
  }
}

function shortestTurn(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

/** Call a function with the index of each row of a sample, and the columns. */
export function eachRow(rows, sample, call) {
  for (let row = rows.first[sample]; row < rows.first[sample + 1]; row += 1) call(row, rows.columns);
}

/** Return the number of rows of all samples. */
export function rowCount(rows) {
  return rows.first.at(-1);
}

/** Return the spans of an episode in which its guard raised the alarm or the fallback intervened: ``{state, first, last}``. */
export function guardSpans({ data, last }) {
  const spans = [];
  for (const [sample, state] of (data.guard?.state ?? []).entries()) {
    const before = spans.at(-1);
    if (before && before.last === sample && before.state === state) before.last = Math.min(last, sample + 1);
    else if (state) spans.push({ state, first: sample, last: Math.min(last, sample + 1) });
  }
  return spans;
}

/** Return a time in tenths of a second as text: ``3.2``. Halves are rounded up, as by the server. */
export function tenths(time_s) {
  return (Math.floor(10 * time_s + 0.5 + 1e-4) / 10).toFixed(1);
}

/** Return a time as text: ``3.2 s``. */
export function seconds(time_s) {
  return `${tenths(time_s)} s`;
}

/** Plays an episode: owns the time that is shown. */
export class Player {
  #listeners = [];
  #frame = null;
  #drawn_ms = 0;

  /**
   * @param {Episode} episode
   * @param {AbortSignal} signal Stops the player.
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
   * Call a function on every change, with the player and what changed: ``time``, ``sample``, ``state``. The first call comes at
   * once, with all three.
   */
  listen(listener) {
    this.#listeners.push(listener);
    listener(this, { time: true, sample: true, state: true });
  }

  /** Jump to a time. */
  seek(time_s) {
    const { episode } = this;
    this.time_s = Math.min(episode.end_s, Math.max(episode.start_s, time_s));
    const sample = episode.sampleAt(this.time_s);
    const changed = sample !== this.sample;
    this.sample = sample;
    this.#notify({ time: true, sample: changed });
  }

  /** Pause, and jump to a time. */
  hold(time_s) {
    this.pause();
    this.seek(time_s);
  }

  /** Jump to a sample. */
  show(sample) {
    this.seek(this.episode.times[Math.min(this.episode.last, Math.max(0, sample))]);
  }

  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }

  /** Play on; from the start if the episode is at its end. */
  play() {
    if (this.playing || this.signal.aborted) return;
    if (this.time_s >= this.episode.end_s) this.seek(this.episode.start_s);
    this.#drawn_ms = performance.now();
    this.#frame = requestAnimationFrame((now) => this.#next(now));
    this.#notify({ state: true });
  }

  pause() {
    if (!this.playing) return;
    cancelAnimationFrame(this.#frame);
    this.#frame = null;
    this.#notify({ state: true });
  }

  setSpeed(speed) {
    this.speed = speed;
    this.#notify({ state: true });
  }

  #next(now_ms) {
    const passed_s = Math.min(LONGEST_FRAME_S, Math.max(0, (now_ms - this.#drawn_ms) / 1000));
    this.#drawn_ms = now_ms;
    this.seek(this.time_s + passed_s * this.speed);
    if (this.time_s >= this.episode.end_s) this.pause();
    else if (this.playing) this.#frame = requestAnimationFrame((now) => this.#next(now));
  }

  #notify(changed) {
    if (this.signal.aborted) return;
    for (const listener of this.#listeners) listener(this, changed);
  }
}
