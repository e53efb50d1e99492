/** The solutions on the map, column by column; new ones are added, those that are known are not asked for again. */

import { Conditional, UNCHANGED } from "../../api.js";

const COLUMNS = ["number", "told_in", "unsafe", "robustness", "x", "y"];

/** A campaign's points. */
export class MapData {
  #conditional = new Conditional();
  version = "";
  count = 0;
  number = new Int32Array(0);
  told_in = new Int32Array(0);
  unsafe = new Uint8Array(0);
  robustness = new Float32Array(0);
  x = new Float32Array(0);
  y = new Float32Array(0);
  fitness = new Float32Array(0);
  by = null;
  about = null;

  /** Ask for what is new; returns whether anything is. */
  async load(campaign, parameter, signal) {
    const query = new URLSearchParams();
    if (this.version) {
      query.set("version", this.version);
      query.set("after", this.count);
    }
    if (parameter) query.set("parameter", parameter);
    const read = await this.#conditional.get(`campaigns/${campaign}/map?${query}`, { signal });
    if (read === UNCHANGED) return false;
    this.#take(read);
    return true;
  }

  #take(read) {
    for (const name of COLUMNS) this[name] = joined(this[name], read.first, read[name]);
    this.count = this.number.length;
    this.version = read.version;
    this.fitness = Float32Array.from(read.fitness);
    this.by = read.by && { ...read.by, values: Float32Array.from(read.by.values, (value) => value ?? NaN) };
    const { generation, evaluated, drawn, explained, across, up } = read;
    this.about = { generation, evaluated, drawn, explained, across, up };
  }
}

function joined(known, first, more) {
  const whole = new known.constructor(first + more.length);
  whole.set(known.subarray(0, first));
  whole.set(more, first);
  return whole;
}
