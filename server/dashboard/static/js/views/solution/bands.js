/** Boxes of following samples that are of one thing, joined: a band of columns of the picture over time. */

import { eachRow } from "./episode.js";

const LEAST_OVERLAP = 0.2;
const MISSED_SAMPLES = 2;

/**
 * Return the bands of rows of boxes.
 *
 * @param {object} rows As an episode has them.
 * @param {number} samples
 * @returns {{label: number, samples: number[], low: number[], high: number[]}[]} By the sample that they begin at.
 */
export function bands(rows, samples) {
  const found = [];
  let open = [];
  for (let sample = 0; sample < samples; sample += 1) {
    const taken = new Set();
    eachRow(rows, sample, (row, columns) => {
      const box = {
        label: columns.label[row], low: columns.x_min_px[row], high: columns.x_max_px[row],
        top: columns.y_min_px[row], bottom: columns.y_max_px[row],
      };
      if (box.low === null || box.high === null) return;
      let best = null;
      let most = LEAST_OVERLAP;
      for (const band of open) {
        if (band.label !== box.label || taken.has(band)) continue;
        const much = overlap(band.last, box);
        if (much >= most) [best, most] = [band, much];
      }
      if (best === null) {
        best = { label: box.label, samples: [], low: [], high: [] };
        found.push(best);
        open.push(best);
      }
      taken.add(best);
      best.last = box;
      best.samples.push(sample);
      best.low.push(box.low);
      best.high.push(box.high);
    });
    open = open.filter((band) => band.samples.at(-1) >= sample - MISSED_SAMPLES);
  }
  return found;
}

/** Return the share of two boxes that is common to both. */
function overlap(a, b) {
  const wide = Math.min(a.high, b.high) - Math.max(a.low, b.low);
  const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
  if (wide <= 0 || high <= 0) return 0;
  const both = wide * high;
  const area = (box) => (box.high - box.low) * (box.bottom - box.top);
  return both / (area(a) + area(b) - both);
}
