/** What can be saved of an episode: a film, a picture, its specification. */

import { ApiError, request, saveBlob } from "../../api.js";
import { toast } from "../../context.js";
import { h, text } from "../../dom.js";

const ASKED = 30;

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
      const answer = await whenMade(context, path);
      if (answer) saveBlob(await answer.blob(), file);
      else toast("The episode is not simulated yet; try again later.", { bad: true });
    } catch (error) {
      if (context.signal.aborted) return;
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) context.signIn();
      else toast(error.message, { bad: true });
    } finally {
      button.disabled = false;
      text(button, words);
    }
  } }, words);
  return button;
}

/** Ask until it is there: 202 means that a worker makes the trace. */
async function whenMade(context, path) {
  for (let asked = 0; asked < ASKED; asked += 1) {
    const answer = await request("GET", `${path}?wait_s=20`, { signal: context.signal });
    if (answer.status === 200) return answer;
  }
  return null;
}
