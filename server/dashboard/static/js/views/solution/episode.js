/** An episode as it came, and what is asked of it at a time: where somebody is, which boxes there are. */

const TELEPORT_M = 20;
/** Nobody drives that far between two samples: what does is somewhere else, not on the way there. */

export const LABELS = ["vehicle", "person"];

/** One episode. Samples are counted from 0; between two of them, positions are taken from the line between. */
export class Episode {
  /** @param {object} told As ``GET …/episode`` answers. */
  constructor(told) {
    this.told = told;
    this.times = told.time_s;
    this.last = this.times.length - 1;
    this.start_s = this.times[0];
    this.end_s = this.times[this.last];
    this.camera = told.camera;
    this.film = told.film;
    this.story = told.story;
    this.report = told.words.report;
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

  /** Return the sample before a time, and how far it is from there to the next one, in [0, 1]. */
  between(time_s) {
    const sample = this.sampleAt(time_s);
    if (sample >= this.last) return { sample, share: 0 };
    const step_s = this.times[sample + 1] - this.times[sample];
    return { sample, share: step_s > 0 ? Math.min(1, Math.max(0, (time_s - this.times[sample]) / step_s)) : 0 };
  }

  /** Return where a track is: ``{x, y, yaw, speed}``, or null if it is not there. */
  pose(track, { sample, share }) {
    const x = track.x_m[sample];
    const y = track.y_m[sample];
    const yaw = track.yaw_rad[sample];
    if (x === null || y === null || yaw === null) return null;
    const here = { x, y, yaw, speed: track.speed_mps[sample] ?? 0 };
    const nextX = share > 0 ? track.x_m[sample + 1] : null;
    const nextY = share > 0 ? track.y_m[sample + 1] : null;
    if (nextX === null || nextY === null || Math.hypot(nextX - x, nextY - y) > TELEPORT_M) return here;
    here.x += share * (nextX - x);
    here.y += share * (nextY - y);
    here.yaw += share * turn(track.yaw_rad[sample + 1] - yaw);
    return here;
  }

  /** Return how a track's speed changes at a sample, in m/s². */
  accel(track, sample) {
    if (track.accel_mps2) return track.accel_mps2[sample] ?? 0;
    if (sample === 0) return 0;
    const change = (track.speed_mps[sample] ?? 0) - (track.speed_mps[sample - 1] ?? 0);
    return change / Math.max(1e-6, this.times[sample] - this.times[sample - 1]);
  }

  /** Return the first sample at which a requirement is violated, or -1. */
  violatedAt(requirement) {
    return (this.told.robustness[requirement] ?? []).findIndex((value) => value !== null && value < 0);
  }
}

function turn(angle) {
  return angle - 2 * Math.PI * Math.round(angle / (2 * Math.PI));
}

/** Call a function with each row of a sample: its number among all rows. */
export function eachRow(rows, sample, call) {
  for (let row = rows.first[sample]; row < rows.first[sample + 1]; row += 1) call(row, rows.columns);
}

/** Return how many rows there are at all. */
export function rowCount(rows) {
  return rows.first.at(-1);
}
