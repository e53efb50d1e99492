/** Form fields generated from a JSON schema. An empty field means the default; errors are shown next to the field. */

import { attribute, h, text } from "../dom.js";
import { capital, plainId, spaced } from "../format.js";

/**
 * @typedef {object} FormField
 * @property {string} pointer JSON pointer of the field, such as ``/problem/params/duration_s``.
 * @property {boolean} main Whether it is shown at once, and not among the further fields.
 * @property {HTMLElement} node
 * @property {() => *} read Return the value; undefined if the field is empty.
 * @property {(value: *) => void} fill
 * @property {(usual: *) => void} suggest Show another default, or the schema's if undefined.
 * @property {(message: string) => void} complain Show an error; an empty text removes it.
 */

/** Return a field for one property of a JSON schema. */
export function field(name, schema, pointer, { label = labelOf(name, schema), required = false, help = schema.description } = {}) {
  const id = `field${pointer.replaceAll("/", "-")}`;
  const wrong = h("p.wrong", { id: `${id}-wrong`, role: "alert", hidden: true });
  const meaning = h("span");
  const hint = help || schema.unit || schema.options ? h("p.help", { id: `${id}-help` }, schema.options && meaning,
    [!schema.options && help, schema.unit && h("span.read-out", null, ` In ${schema.unit}.`)]) : null;
  const input = control(schema, { id, required, described: [hint && `${id}-help`, `${id}-wrong`].filter(Boolean).join(" ") });
  showDefault(input, schema.default);
  const node = h("div.field", null, h("label", { for: id }, label),
    schema.unit ? h("div.with-unit", null, input, h("span.muted", { "aria-hidden": "true" }, schema.unit)) : input, hint, wrong);

  /** Say what the chosen option means. */
  function explain() {
    const chosen = valueOf(input, schema) ?? schema.default;
    const known = schema.options?.filter((one) => [chosen].flat().includes(one.value)) ?? [];
    text(meaning, known.length ? `${known.map((one) => one.words.replace(/\.$/, "")).join("; ")}. ` : "");
  }
  if (schema.options) {
    input.addEventListener("change", explain);
    explain();
  }
  return {
    pointer, node, main: Boolean(schema.main),
    read: () => valueOf(input, schema),
    fill: (value) => {
      fill(input, value);
      explain();
    },
    complain: (message) => {
      text(wrong, message);
      wrong.hidden = !message;
      attribute(input, "aria-invalid", message ? "true" : null);
    },
    focus: () => input.focus(),
    suggest: (usual) => showDefault(input, usual ?? schema.default),
  };
}

/** Return the name of a field in words: the schema's label and the name itself, or the name without its unit. */
function labelOf(name, { label, unit }) {
  if (label) return label.toLowerCase().includes(name) ? label : [`${label} `, h("code", null, name)];
  return capital(spaced(unit && name.endsWith(`_${unit}`) ? name.slice(0, -unit.length - 1) : name));
}

function control(schema, { id, required, described }) {
  const about = { id, "aria-describedby": described, required: required || null };
  if (schema.options) return h("select", about, schema.options.map(({ value }) => h("option", { value }, spaced(plainId(value).replaceAll("-", " ")))));
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
  const words = () => spaced([usual].flat().map((one) => (input.querySelector?.(`option[value="${CSS.escape(String(one))}"]`)?.textContent ?? String(one)).replace(/ \(default\)$/, "")).join(" and "));
  if (input.localName === "input") {
    attribute(input, "placeholder", known ? String(usual) : null);
  } else if (input.localName === "select") {
    const first = input.querySelector("option[value='']");
    if (known && first) text(first, `${words()} (default)`);
    else if (known) input.prepend(h("option", { value: "", selected: true }, `${words()} (default)`));
  }
}

function valueOf(input, schema) {
  // An unparsable number has an empty value, which is not the same as no input.
  const written = input.validity.badInput ? "not a number" : input.value.trim();
  if (written === "") return undefined;
  if (schema.type === "boolean") return written === "true";
  if (schema.type === "integer" || schema.type === "number") return input.validity.badInput ? written : Number(written);
  if (schema.type === "array" || schema.type === "object" || (schema.options && /^[[{]/.test(written))) {
    try {
      return JSON.parse(written);
    } catch {
      return written; // the server reports what it expected
    }
  }
  return written;
}

/** Return the names of requirements: ids without versions, and those of formulas. */
function namesIn(value) {
  return [value].flat().flatMap((one) => (typeof one === "object" ? Object.keys(one) : plainId(one)));
}

function fill(input, value) {
  const written = value === undefined || value === null ? "" : typeof value === "object" ? JSON.stringify(value) : String(value);
  if (input.localName === "select" && written && ![...input.options].some((one) => one.value === written)) {
    input.append(h("option", { value: written }, typeof value === "object" ? namesIn(value).join(" and ") : written)); // the server validates it
  }
  input.value = written;
}
