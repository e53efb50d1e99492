/** What can be saved of an episode: a film, a picture, its specification. */

import { saveBlob } from "../../api.js";
import { h, text } from "../../dom.js";
import { whenMade } from "../../polling.js";

/** Return the buttons that save a solution's episode. */
export function downloads(context, path, name, spec) {
  return h("div.actions", { role: "group", "aria-label": "Save" },
    drawn(context, `${path}/replay.mp4`, `${name}.mp4`, "Film, MP4"), drawn(context, `${path}/replay.png`, `${name}.png`, "Picture, PNG"),
    spec && h("button", { type: "button", title: "The episode with its seed: it can be run again from this", onclick: () => {
      saveBlob(new Blob([`${JSON.stringify(spec, null, 2)}\n`], { type: "application/json" }), `${name}.json`);
    } }, "Specification, JSON"));
}

function drawn(context, path, file, words) {
  const button = h("button", { type: "button", onclick: async () => {
    button.disabled = true;
    text(button, "Drawing …");
    try {
      await context.tell(async () => {
        saveBlob(await whenMade(path, { ...context.retrying, as: "blob" }), file);
      });
    } finally {
      button.disabled = false;
      text(button, words);
    }
  } }, words);
  return button;
}
