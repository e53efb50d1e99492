/** In which settings campaigns differ. */

import { minus } from "../../format.js";

const LEFT_OUT = new Set(["name"]);

/** Return a row a setting that is not the same for all: its path, and its value a campaign. */
export function differences(campaigns) {
  const flat = campaigns.map((campaign) => Object.fromEntries(flattened(campaign.body)));
  const paths = [...new Set(flat.flatMap((one) => Object.keys(one)))];
  return paths
    .filter((path) => new Set(flat.map((one) => one[path])).size > 1)
    .map((path) => ({ key: path, label: path, cells: flat.map((one) => one[path] ?? "–") }));
}

function* flattened(value, path = []) {
  if (value !== null && typeof value === "object" && !Array.isArray(value)) {
    for (const [name, part] of Object.entries(value)) {
      if (path.length || !LEFT_OUT.has(name)) yield* flattened(part, name === "params" ? path : [...path, name]);
    }
  } else {
    yield [path.join(" "), typeof value === "string" ? value : minus(JSON.stringify(value))];
  }
}
