/** The tags and notes of a campaign, which people may edit in place at any time. */

import { ApiError, send } from "../../api.js";
import { h, keyed, replace, text } from "../../dom.js";
import { sentence } from "../../format.js";
import { link } from "../../router.js";

/**
 * Return the tags and notes; ``update`` takes the progress of the campaign, which has both.
 *
 * @param {Context} context
 * @param {string} id Id of the campaign.
 * @param {() => void} changed Called when they have been saved.
 */
export function labels(context, id, changed) {
  let known = { tags: [], notes: "" };
  const tags = h("ul.chips.tags", { "aria-label": "Tags" });
  const notes = h("p.notes", { hidden: true });
  const edit = context.may.steer ? h("button.quiet", { type: "button", onclick: open }, "") : null;
  const shown = h("div", null, h("div.inline", null, tags, edit), notes);
  const editor = h("div");
  const node = h("section.labels", { "aria-label": "Tags and notes", hidden: true }, shown, editor);

  function open() {
    const before = known;
    const words = h("input", { id: "edit-tags", type: "text", value: before.tags.join(" "), spellcheck: "false", autocapitalize: "none", "aria-describedby": "edit-tags-help edit-wrong" });
    const about = h("textarea", { id: "edit-notes", rows: 4, value: before.notes, "aria-describedby": "edit-wrong" });
    const wrong = h("p.wrong", { id: "edit-wrong", role: "alert" });
    const save = h("button.primary", { type: "submit" }, "Save");
    replace(editor, h("form.card", { novalidate: true, onsubmit: async (event) => {
      event.preventDefault();
      replace(wrong);
      save.disabled = true;
      const refused = await refusal(before, words.value, about.value);
      save.disabled = false;
      if (refused === null) close();
      else text(wrong, refused);
    }, onkeydown: (event) => event.key === "Escape" && close() },
    h("div.field", null, h("label", { for: "edit-tags" }, "Tags"), words, h("p.help", { id: "edit-tags-help" }, "Words separated by spaces, such as: night release-4")),
    h("div.field", null, h("label", { for: "edit-notes" }, "Notes"), about),
    wrong, h("div.actions", null, save, h("button", { type: "button", onclick: close }, "Cancel"))));
    shown.hidden = true;
    words.focus();
  }

  function close() {
    replace(editor);
    shown.hidden = false;
    edit.focus();
  }

  /** Save what differs from before, so that others' changes meanwhile are kept; return why it was refused, or null. */
  async function refusal(before, written, about) {
    const wanted = new Set(written.trim().split(/[\s,]+/).filter(Boolean).map((tag) => tag.toLowerCase()));
    const change = {
      add_tags: [...wanted].filter((tag) => !before.tags.includes(tag)),
      remove_tags: before.tags.filter((tag) => !wanted.has(tag)),
      ...(about === before.notes ? {} : { notes: about }),
    };
    try {
      node.update(await send("PATCH", `campaigns/${id}`, { json: change }));
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) context.signIn();
      return error.errors.map((one) => sentence(one.message)).join(" ") || sentence(error.message);
    }
    changed();
    return null;
  }

  node.update = (read) => {
    known = { tags: read.tags, notes: read.notes };
    node.hidden = !edit && read.tags.length === 0 && !read.notes;
    keyed(tags, read.tags, (tag) => tag, (tag) => h("li", null, h("a.tag", { href: link("campaigns", { tag }), title: "All campaigns with this tag" }, tag)));
    text(notes, read.notes);
    notes.hidden = !read.notes;
    if (edit) text(edit, read.tags.length || read.notes ? "Edit tags and notes" : "Add tags or notes");
  };
  return node;
}
