/** Form fields with one row for each parameter of a search space: its limits in an ODD, or its distribution in operation. */

import { h, replace, text } from "../dom.js";
import { spaced } from "../format.js";

const HELP = {
  limits: "Values to which the search is limited, the operational design domain. Parameters that are not listed are not limited.",
  distribution: "How often values occur in operation, for estimates of rates. Parameters that are not listed are equally distributed.",
};

/**
 * Return a field as `field` does, with rows instead of one control.
 *
 * @param {object} schema With ``by_parameter``: ``limits``, or ``distribution`` with the ``numbers`` of each kind of it.
 * @param {string} pointer JSON pointer of the field.
 * @param {{components: object[]} | null} space Search space of the problem.
 */
export function byParameter(schema, pointer, space) {
  const id = `field${pointer.replaceAll("/", "-")}`;
  const known = new Map((space?.components ?? []).flatMap((component) => component.parameters.map((one) => [`${component.name}.${one.name}`, one])));
  const wrong = h("p.wrong", { id: `${id}-wrong`, role: "alert", hidden: true });
  const list = h("div.parameter-rows");
  const add = h("button", { type: "button", onclick: () => append().focus() }, schema.by_parameter === "limits" ? "Limit a parameter" : "Distribute a parameter");
  const node = h("fieldset.field.by-parameter", { "aria-describedby": `${id}-help ${id}-wrong` },
    h("legend", null, schema.label ?? schema.title), h("p.help", { id: `${id}-help` }, HELP[schema.by_parameter]), list, h("div", null, add), wrong);
  const editorOf = schema.by_parameter === "limits" ? limits : distribution(schema.numbers);
  let rows = [];

  function append(parameter = "", value = undefined) {
    const choice = h("select", { "aria-label": `Parameter of the ${schema.label ?? schema.title}`, onchange: () => turn() }, h("option", { value: "" }, "choose a parameter"),
      (space?.components ?? []).map((component) => h("optgroup", { label: spaced(component.name) },
        component.parameters.map((one) => h("option", { value: `${component.name}.${one.name}` }, one.title || spaced(one.name).replace(".", ": "))))));
    if (parameter && !known.has(parameter)) choice.append(h("option", { value: parameter }, parameter)); // such as one with a *
    choice.value = parameter;
    const place = h("div.parameter-value");
    const row = { node: null, name: () => choice.value, editor: null, focus: () => choice.focus() };
    row.node = h("div.parameter-row", null, choice, place,
      h("button.quiet", { type: "button", "aria-label": "Remove this row", onclick: () => remove(row) }, "×"));

    function turn(given) {
      const of = parameterOf(choice.value);
      row.editor = choice.value ? (of && editorOf(of, given)) || asJson(given) : null;
      replace(place, row.editor?.nodes);
    }

    turn(value);
    rows.push(row);
    list.append(row.node);
    return row;
  }

  function remove(row) {
    rows = rows.filter((one) => one !== row);
    row.node.remove();
    add.focus();
  }

  /** Return the parameter of a name, or the first that a name with * stands for. */
  function parameterOf(written) {
    if (known.has(written)) return known.get(written);
    const pattern = new RegExp(`^${written.split("*").map((part) => part.replace(/[.+?^${}()|[\]\\]/g, "\\$&")).join(".*")}$`);
    return [...known].find(([one]) => pattern.test(one))?.[1];
  }

  return {
    pointer, node, main: Boolean(schema.main), suggest: () => {},
    read: () => {
      const told = rows.map((row) => [row.name(), row.editor?.read()]).filter(([, value]) => value !== undefined);
      return told.length ? Object.fromEntries(told) : undefined;
    },
    fill: (value) => {
      for (const row of rows) row.node.remove();
      rows = [];
      for (const [parameter, one] of Object.entries(value ?? {})) append(parameter, one);
    },
    complain: (message) => {
      text(wrong, message);
      wrong.hidden = !message;
    },
    focus: () => (rows[0] ?? add).focus(),
  };
}

function number(label, given, usual = "") {
  return h("input", { type: "number", step: "any", "aria-label": label, placeholder: usual, value: given ?? "" });
}

/** Return the number in an input; undefined if there is none, and what is no number as it is, for the server to refuse. */
function numberIn(input) {
  if (input.validity.badInput) return "not a number";
  return input.value.trim() === "" ? undefined : Number(input.value);
}

/** Return an editor of the limits of a parameter; null for what it cannot hold. */
function limits(parameter, given) {
  if (parameter.choices) {
    const allowed = given === undefined ? [] : [given].flat().map(String);
    if (allowed.some((one) => !parameter.choices.includes(one))) return null;
    const boxes = parameter.choices.map((choice) => ({ choice, box: h("input", { type: "checkbox", checked: allowed.includes(choice) }) }));
    return {
      nodes: boxes.map(({ choice, box }) => h("label.check", null, box, spaced(choice))),
      read: () => {
        const chosen = boxes.filter(({ box }) => box.checked).map(({ choice }) => choice);
        return chosen.length === 1 ? chosen[0] : chosen;
      },
    };
  }
  const { min, max } = typeof given === "object" ? given : { min: given, max: given };
  if ([min, max].some((one) => one !== undefined && typeof one !== "number")) return null;
  const [least, most] = [number("Minimum", min, parameter.low), number("Maximum", max, parameter.high)];
  return {
    nodes: ["from ", least, " to ", most, parameter.unit && ` ${parameter.unit}`],
    read: () => {
      const [low, high] = [numberIn(least), numberIn(most)];
      if (low !== undefined && low === high) return low;
      const told = Object.entries({ min: low, max: high }).filter(([, value]) => value !== undefined);
      return told.length ? Object.fromEntries(told) : undefined;
    },
  };
}

/** Return a function that returns an editor of the distribution of a parameter; null for what it cannot hold. */
function distribution(numbers) {
  return (parameter, given) => (parameter.choices ? weights(parameter, given) : continuous(parameter, given, numbers));
}

function weights(parameter, given) {
  const known = given?.weights ?? {};
  if (given && (Object.keys(given).length !== 1 || Object.entries(known).some(([choice, weight]) => !parameter.choices.includes(choice) || typeof weight !== "number"))) return null;
  const inputs = parameter.choices.map((choice) => ({ choice, input: number(`Weight of ${spaced(choice)}`, known[choice], "0") }));
  return {
    nodes: inputs.map(({ choice, input }) => h("label", null, `${spaced(choice)} `, input)),
    read: () => {
      const told = inputs.map(({ choice, input }) => [choice, numberIn(input)]).filter(([, weight]) => weight !== undefined);
      return told.length ? { weights: Object.fromEntries(told) } : undefined;
    },
  };
}

function continuous(parameter, given, numbers) {
  const [kind, known] = Object.entries(given ?? {})[0] ?? [Object.keys(numbers)[0], {}];
  if (!(kind in numbers) || typeof known !== "object" || Object.keys(given ?? {}).length > 1) return null;
  const place = h("span.inline");
  const choice = h("select", { "aria-label": "Kind of distribution", onchange: () => turn({}) }, Object.keys(numbers).map((one) => h("option", { value: one }, one)));
  choice.value = kind;
  let inputs = [];

  function turn(values) {
    inputs = numbers[choice.value].map((name) => ({ name, input: number(`${name} of the distribution`, values[name]) }));
    replace(place, inputs.map(({ name, input }) => h("label", null, `${name} `, input)), parameter.unit && h("span.muted", null, parameter.unit));
  }

  turn(known);
  return {
    nodes: [choice, place],
    read: () => {
      const told = inputs.map(({ name, input }) => [name, numberIn(input)]).filter(([, value]) => value !== undefined);
      return told.length ? { [choice.value]: Object.fromEntries(told) } : undefined;
    },
  };
}

/** Return an editor of what has no fields of its own, such as weights that depend on another parameter. */
function asJson(given) {
  const input = h("input", { type: "text", "aria-label": "Value as JSON", placeholder: "JSON", spellcheck: "false", value: given === undefined ? "" : JSON.stringify(given) });
  return {
    nodes: [input],
    read: () => {
      const written = input.value.trim();
      if (!written) return undefined;
      try {
        return JSON.parse(written);
      } catch {
        return written; // the server says what it expected
      }
    },
  };
}
