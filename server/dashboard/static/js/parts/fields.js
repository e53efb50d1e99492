/** Fields of a form made from a JSON schema: an empty one stands for its default; errors are shown beside them. */

import { attribute, h, text } from "../dom.js";
import { capital, spaced } from "../format.js";

/**
 * @typedef {object} FormField
 * @property {string} pointer Of the field in the document, such as ``/problem/params/duration_s``.
 * @property {HTMLElement} node
 * @property {() => *} read The value; undefined if it is left empty.
 * @property {(value: *) => void} fill
 * @property {(usual: *) => void} suggest Names another default than the schema's, or undefined for that.
 * @property {(message: string) => void} complain Says what is wrong with it; an empty text for nothing.
 */

/** Return a field for one property of a JSON schema. */
export function field(name, schema, pointer, { label = capital(spaced(name)), required = false, help = schema.description } = {}) {
  const id = `field${pointer.replaceAll("/", "-")}`;
  const wrong = h("p.wrong", { id: `${id}-wrong`, role: "alert", hidden: true });
  const hint = help || schema.unit ? h("p.help", { id: `${id}-help` }, [help, schema.unit && `in ${schema.unit}`].filter(Boolean).join(" ").replace(/\. in /, ", in ")) : null;
  const input = control(schema, { id, required, described: [hint && `${id}-help`, `${id}-wrong`].filter(Boolean).join(" ") });
  showDefault(input, schema.default);
  const node = h("div.field", null, h("label", { for: id }, label), input, hint, wrong);
  return {
    pointer, node,
    read: () => valueOf(input, schema),
    fill: (value) => fill(input, value),
    complain: (message) => {
      text(wrong, message);
      wrong.hidden = !message;
      attribute(input, "aria-invalid", message ? "true" : null);
    },
    focus: () => input.focus(),
    suggest: (usual) => showDefault(input, usual ?? schema.default),
  };
}

function control(schema, { id, required, described }) {
  const about = { id, "aria-describedby": described, required: required || null };
  if (schema.enum || schema.type === "boolean") {
    const choices = schema.enum ?? [true, false];
    return h("select", about, choices.map((choice) => h("option", { value: String(choice) }, spaced(String(choice)))));
  }
  if (schema.type === "integer" || schema.type === "number") {
    return h("input", { ...about, type: "number", step: schema.type === "integer" ? 1 : "any", min: schema.minimum, max: schema.maximum });
  }
  if (schema.type === "array" || schema.type === "object") {
    return h("textarea", { ...about, rows: 3, placeholder: "JSON", spellcheck: "false" });
  }
  return h("input", { ...about, type: "text", spellcheck: "false" });
}

/** Say what an empty field stands for; what is filled in stays. */
function showDefault(input, usual) {
  const known = usual !== undefined && usual !== null;
  if (input.localName === "input") {
    attribute(input, "placeholder", known ? String(usual) : null);
  } else if (input.localName === "select") {
    const first = input.querySelector("option[value='']");
    if (known && first) text(first, `${spaced(String(usual))} (default)`);
    else if (known) input.prepend(h("option", { value: "", selected: true }, `${spaced(String(usual))} (default)`));
  }
}

function valueOf(input, schema) {
  // A number that cannot be read has an empty value, which is not the same as none.
  const written = input.validity.badInput ? "not a number" : input.value.trim();
  if (written === "") return undefined;
  if (schema.type === "boolean") return written === "true";
  if (schema.type === "integer" || schema.type === "number") return input.validity.badInput ? written : Number(written);
  if (schema.type === "array" || schema.type === "object") {
    try {
      return JSON.parse(written);
    } catch {
      return written; // the server says what it expected
    }
  }
  return written;
}

function fill(input, value) {
  if (value === undefined || value === null) input.value = "";
  else input.value = typeof value === "object" ? JSON.stringify(value) : String(value);
}
