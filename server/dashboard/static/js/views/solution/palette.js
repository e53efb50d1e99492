/** The colours of a replay, asked for once a theme: a canvas that moves cannot look them up in every frame. */

import { colour } from "../../theme.js";

const NAMES = {
  ground: "--ground", road: "--road", marking: "--marking", building: "--building", pavement: "--replay-pavement",
  tree: "--replay-tree", parked: "--replay-parked", sky: "--replay-sky", edge: "--replay-edge",
  ego: "--safe", vehicle: "--series-6", pedestrian: "--series-4", glass: "--card", brake: "--bad", route: "--replay-route",
  injected: "--unsafe", seen: "--measured", violation: "--bad", ink: "--ink", muted: "--muted", paper: "--card", line: "--line",
  pictureTrue: "--picture-true", pictureFound: "--picture-found", pictureRegion: "--picture-region", pictureShade: "--picture-shade",
};
const SURFACES = {
  road: ["road", null], pavement: ["pavement", "edge"], marking: ["marking", null], crossing: ["marking", null],
  "stop-line": ["marking", null], building: ["building", "edge"], "parked-car": ["parked", "edge"], tree: ["tree", "edge"],
};

/** Return colours by what they are for; ``renew`` asks for them again. */
export function palette() {
  const found = { renew };
  function renew() {
    for (const [use, name] of Object.entries(NAMES)) found[use] = colour(name);
  }
  renew();
  return found;
}

/** Return fill and outline of a kind of surface: names of a palette, the outline may be null. */
export function surfaceColours(kind) {
  return SURFACES[kind] ?? ["pavement", null];
}
