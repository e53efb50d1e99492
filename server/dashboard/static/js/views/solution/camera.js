/** The camera's picture beside the map: a film where there is one, a sketch where boxes are all that is known. */

import { h, text } from "../../dom.js";
import { percent } from "../../format.js";
import { canvas } from "../../parts/charts.js";
import { rowCount } from "./episode.js";
import { FilmPlayer } from "./film.js";
import { palette } from "./palette.js";
import { Sketch } from "./sketch.js";

/**
 * Return the camera's view of a player's episode.
 *
 * @param {import("./player.js").Player} player
 * @param {string} path Of the solution.
 */
export function camera(player, path) {
  const { episode, signal } = player;
  const { film, told } = episode;
  if (!film && rowCount(told.seen) + rowCount(told.given) === 0) {
    return h("div.replay-camera", null, h("h3", null, "Camera"),
      h("p.hint", null, "No boxes were recorded: in this episode the driving system is told where road users are."));
  }
  const colours = palette();
  const [width, height] = film ? film.size_px : [episode.camera.width_px, episode.camera.height_px];
  const said = h("p.hint", { role: "status" });
  const sheet = canvas({
    label: film ? "The camera's picture, with what is there and what was detected" : "A sketch of the camera's picture, with what is there and what was reported",
    ratio: width / height, most: 520, signal, recolour: colours.renew, draw,
  });
  const painter = film ? new FilmPlayer(episode, colours, path, () => sheet.redraw(), signal) : new Sketch(episode, colours);

  function draw(pen, wide, high) {
    const stands = painter.draw(pen, player.sample, wide, high);
    if (film) text(said, stands.missing ? "This picture of the film is not kept any more." : "");
  }

  player.listen((_, changed) => changed.sample && sheet.redraw());
  return h("div.replay-camera", null, h("h3", null, film ? "What the camera saw" : "Camera (a sketch)"), sheet, said, film ? filmKeys() : sketchKeys());

  function filmKeys() {
    const regions = Object.keys(film.regions);
    return [
      h("ul.legend", null, key("box true", "there"), key("box found dashed", `detected, score at least ${film.threshold}`),
        regions.length > 0 && key("box region", `a person here brakes${regions.length > 1 ? " (dotted: a vehicle)" : ""}`)),
      h("label.check.small", null, h("input", { type: "checkbox", onchange: (event) => {
        painter.unsure = event.target.checked;
        sheet.redraw();
      } }), ` Less sure detections, too (from ${percent(0.1)})`),
    ];
  }

  function sketchKeys() {
    return h("ul.legend", null, key("box seen", "there: what the component sees"),
      rowCount(told.given) > 0 && key("box given dashed", `${episode.report}: what the driving system is told`));
  }
}

function key(classes, words) {
  return h("li", null, h("i", { class: `key ${classes}` }), words);
}
