/** How points of the map are coloured: by verdict, by a figure, or by a category. */

import { figure, spaced } from "../../format.js";
import { colour } from "../../theme.js";

const STEPS = 24;
// Stops of the viridis map by S. van der Walt and N. Smith (CC0), evenly spaced.
const STOPS = [[68, 1, 84], [65, 68, 135], [42, 120, 142], [34, 168, 132], [122, 209, 81], [253, 231, 37]];
const CATEGORIES = ["#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#999933", "#bbbbbb", "#882255", "#44aa99"];

/**
 * @typedef {object} Colouring
 * @property {Uint8Array} index Of the colour of each point.
 * @property {string[]} colours
 * @property {{label: string, colour: string}[]} legend
 */

/** Colour by verdict. */
export function byVerdict(data) {
  const colours = [colour("--safe"), colour("--unsafe")];
  return {
    index: data.unsafe, colours,
    legend: [{ label: "safe", colour: colours[0] }, { label: "unsafe", colour: colours[1] }],
  };
}

/** Colour by a figure, from its lowest to its highest; what is not known is grey. */
export function byFigure(values, { low = null, high = null, unit = "" } = {}) {
  let least = low ?? Infinity;
  let most = high ?? -Infinity;
  if (low === null || high === null) {
    for (const value of values) {
      if (!Number.isFinite(value)) continue;
      if (low === null && value < least) least = value;
      if (high === null && value > most) most = value;
    }
  }
  const index = new Uint8Array(values.length);
  const range = most - least || 1;
  for (let i = 0; i < values.length; i += 1) {
    index[i] = Number.isFinite(values[i])
      ? Math.max(0, Math.min(STEPS - 1, Math.floor(((values[i] - least) / range) * STEPS))) : STEPS;
  }
  const colours = Array.from({ length: STEPS }, (_, step) => ramp(step / (STEPS - 1)));
  const ends = [least, (least + most) / 2, most].map((value, place) => ({
    label: `${figure(value)}${unit ? ` ${unit}` : ""}`, colour: colours[Math.round((place / 2) * (STEPS - 1))],
  }));
  return { index, colours: [...colours, colour("--pending")], legend: Number.isFinite(least) ? ends : [] };
}

/** Colour by a category. */
export function byCategory(values, choices) {
  const index = new Uint8Array(values.length);
  const many = Math.min(choices.length, CATEGORIES.length);
  for (let i = 0; i < values.length; i += 1) {
    index[i] = Number.isFinite(values[i]) ? Math.min(values[i], many - 1) : many;
  }
  const colours = CATEGORIES.slice(0, many);
  const legend = colours.map((own, place) => ({
    label: place === many - 1 && choices.length > many ? "others" : spaced(choices[place]), colour: own,
  }));
  return { index, colours: [...colours, colour("--pending")], legend };
}

function ramp(share) {
  const at = share * (STOPS.length - 1);
  const below = Math.min(STOPS.length - 2, Math.floor(at));
  const mixed = STOPS[below].map((from, channel) => Math.round(from + (STOPS[below + 1][channel] - from) * (at - below)));
  return `rgb(${mixed.join(",")})`;
}
