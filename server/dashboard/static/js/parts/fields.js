/** Form fields generated from a JSON schema. An empty field means the default; errors are shown next to the field. */

import { attribute, h, text } from "../dom.js";
import { capital, spaced } from "../format.js";

/**
 * @typedef {object} FormField
 * @property {string} pointer JSON pointer of the field, such as ``/problem/params/duration_s``.
 * @property {HTMLElement} node
 * @property {() => *} read Return the value; undefined if the field is empty.
 * @property {(value: *) => void} fill
 * @property {(usual: *) => void} suggest Show another default, or the schema's if undefined.
 * @property {(message: string) => void} complain Show an error; an empty text removes it.
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

/** Show the default of an empty field. */
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
  // An unparsable number has an empty value, which is not the same as no input.
  const written = input.validity.badInput ? "not a number" : input.value.trim();
  if (written === "") return undefined;
  if (schema.type === "boolean") return written === "true";
  if (schema.type === "integer" || schema.type === "number") return input.validity.badInput ? written : Number(written);
  if (schema.type === "array" || schema.type === "object") {
    try {
      return JSON.parse(written);
    } catch {
      return written; // the server reports what it expected
    }
  }
  return written;
}

function fill(input, value) {
  if (value === undefined || value === null) input.value = "";
  else input.value = typeof value === "object" ? JSON.stringify(value) : String(value);
}
