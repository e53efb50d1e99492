/** The submission of a campaign: with a form generated from the catalogue's schemas, or as a campaign file. */

import { ApiError, send } from "../api.js";
import { h, replace, text } from "../dom.js";
import { plainId, sentence } from "../format.js";
import { go } from "../router.js";
import { callout } from "../parts/elements.js";
import { byParameter } from "../parts/by_parameter.js";
import { field } from "../parts/fields.js";

const FIRST = { problem: "urban-errors@1", algorithm: "edge@2" };
const EXAMPLE = `# A campaign file for brink run or brink submit.
name: quickstart
problem:
  id: urban-errors@1
  params:
    requirement: front-gap@1
algorithm:
  id: edge@2
budget:
  simulations: 500
seed: 1
`;

export async function show(main, context, { query }) {
  context.title("New campaign");
  if (!context.may.steer) {
    replace(main, h("h1", null, "New campaign"), callout("warn", "This token is read-only. A token of scope user can submit campaigns."));
    return;
  }
  const goesOn = query.get("start_from");
  const from = goesOn ?? query.get("from");
  const [problems, algorithms, description, model] = await Promise.all([
    context.get("problems"), context.get("algorithms"), schemas(context),
    from ? context.get(`campaigns/${encodeURIComponent(from)}`) : null,
  ]);
  const trouble = h("div", { role: "alert" });
  const form = formOf({ problems: problems.filter((one) => !one.python_only), algorithms: algorithms.filter((one) => !one.internal), description });
  const file = h("textarea", { id: "yaml", spellcheck: "false", "aria-describedby": "yaml-help" });
  file.value = EXAMPLE;
  const panes = {
    form: h("div", null, form.node),
    file: h("div.card", { hidden: true }, h("label", { for: "yaml" }, "Campaign file"), file,
      h("p.hint", { id: "yaml-help" }, "YAML or JSON with the same fields as the form, plus llm for a language model.")),
  };
  let mode = "form";
  let left = false; // whether the form could not represent the file, which must then not be overwritten
  let untouched = JSON.stringify(form.read(), null, 2);
  const modes = Object.entries({ form: "Form", file: "Campaign file" }).map(([name, words]) => h("button",
    { type: "button", "aria-pressed": String(name === mode), data: { mode: name }, onclick: () => turn(name) }, words));
  const submit = h("button.primary", { type: "submit" }, "Submit campaign");
  const check = h("button", { type: "button", onclick: () => attempt(checked) }, "Check only");

  replace(main, h("p.crumb", null, h("a", { href: "#/campaigns" }, "Campaigns")),
    h("div.head", null, h("h1", null, model ? `${goesOn ? "Go on from" : "Clone of"} ${model.name}` : "New campaign"), h("div.segments", { role: "group", "aria-label": "Input" }, modes)),
    h("form.new-campaign", { novalidate: true, onsubmit: (event) => { event.preventDefault(); attempt(submitted); } },
      trouble, panes.form, panes.file, h("div.actions", null, submit, check)));
  if (model) form.fill(bodyFrom(model, query));
  else if (query.has("body")) form.fill(JSON.parse(query.get("body")));

  /** Switch between form and file, and convert what was entered. */
  async function turn(name) {
    if (name === mode) return;
    const taken = name === "file" ? fileFromForm() : await attempt(async () => form.fill(await written()));
    left = name === "form" && !taken;
    mode = name;
    for (const [each, pane] of Object.entries(panes)) pane.hidden = each !== mode;
    for (const each of modes) each.setAttribute("aria-pressed", String(each.dataset.mode === mode));
    if (taken) replace(trouble);
    else trouble.prepend(callout("warn", "The file could not be converted, so the form is unchanged. Your text is kept."));
  }

  /** Convert the form to a file, unless the form is untouched: the example or earlier text is then more useful. */
  function fileFromForm() {
    const now = JSON.stringify(form.read(), null, 2);
    if (now !== untouched && !left) file.value = `# JSON is also YAML.\n${now}\n`;
    untouched = now;
    return true;
  }

  /** Return the campaign as entered. */
  async function written() {
    return mode === "form" ? form.read() : send("POST", "campaigns/check", { text: file.value, headers: YAML });
  }

  async function submitted() {
    const made = await send("POST", "campaigns", { json: await written(), headers: { "Idempotency-Key": key() } });
    go("campaigns", made.id);
  }

  async function checked() {
    const body = await send("POST", "campaigns/check", { text: JSON.stringify(await written()), headers: YAML });
    replace(trouble, callout("", `${body.name} is valid: ${body.problem.id}, ${body.algorithm.id}, ${body.budget.simulations} simulations.`));
  }

  let attempted = "";
  let keyOf = "";

  /** Return the idempotency key of the current text: a second click on Submit creates no second campaign. */
  function key() {
    const told = JSON.stringify(mode === "form" ? form.read() : file.value);
    if (told !== attempted) [attempted, keyOf] = [told, `dashboard-${crypto.randomUUID?.() ?? `${Date.now()}-${Math.random()}`}`];
    return keyOf;
  }

  /** Run an action, and show errors next to the fields. Returns whether it succeeded. */
  async function attempt(doing) {
    replace(trouble);
    form.complain([]);
    submit.disabled = check.disabled = true;
    try {
      await doing();
      return true;
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (error.status === 401) {
        context.signIn();
        return false;
      }
      const rest = mode === "form" ? form.complain(error.errors) : error.errors;
      const words = error.errors.length ? rest.map((one) => h("li", null, one.pointer && h("code", null, fieldName(one.pointer)), one.pointer && ": ", one.nearest ? sentence(one.message) : one.message, one.nearest && ` Did you mean ${one.nearest}?`)) : [h("li", null, error.message)];
      replace(trouble, callout("bad", words.length ? h("ul.plain", null, words) : "Some fields are invalid; see the messages next to them."));
      return false;
    } finally {
      submit.disabled = check.disabled = false;
    }
  }
}

const YAML = { "Content-Type": "application/yaml" };

/** Return the body of another campaign as the address asks for it: with the next seed, and with what is to be different. */
function bodyFrom({ id, body }, query) {
  const requirement = query.get("requirement");
  return {
    ...body, tags: [], notes: "",
    ...(query.has("start_from") ? { start_from: { campaign: id } } : {}),
    problem: requirement ? { ...body.problem, params: { ...body.problem.params, requirement } } : body.problem,
    budget: { simulations: Number(query.get("simulations")) || body.budget.simulations },
    seed: Math.min(body.seed + 1, Number.MAX_SAFE_INTEGER),
  };
}

/** Return the schemas of a campaign from the OpenAPI document. */
async function schemas(context) {
  const read = await fetch(new URL("openapi.json", document.baseURI), { signal: context.signal });
  return (await read.json()).components.schemas;
}

function formOf({ problems, algorithms, description }) {
  const campaign = description.CampaignBody.properties;
  const own = [
    field("name", campaign.name, "/name", { required: true, help: "A name of your choice." }),
    field("simulations", description.Budget.properties.simulations, "/budget/simulations", { required: true, label: "Simulations", help: "Budget of the campaign." }),
    field("seed", campaign.seed, "/seed", { help: "The same seed gives the same results." }),
  ];
  const further = [field("priority", campaign.priority, "/priority"), field("repeats", campaign.repeats, "/repeats")];
  const execution = Object.entries(description.Execution.properties).map(([name, schema]) => field(name, schema, `/execution/${name}`));
  const algorithm = plugin("algorithm", "Algorithm", algorithms, FIRST.algorithm);
  own.push(...further);
  const problem = plugin("problem", "Problem", problems, FIRST.problem, (chosen) => {
    algorithm.suggest(chosen?.algorithm_defaults ?? {});
    algorithm.follow(chosen?.first_algorithm);
  });
  const every = () => [...own, ...execution, ...problem.fields(), ...algorithm.fields()];
  let kept = {}; // parts without a field in the form
  const start = h("p.hint", { hidden: true }, h("span"), " ", h("button.quiet", { type: "button", onclick: () => {
    delete kept.start_from;
    showStart();
  } }, "Start from nothing"));

  const node = h("div.stack", null,
    h("fieldset.card", null, h("legend", null, "Campaign"), h("div.fields", null, own.filter((one) => !further.includes(one)).map((one) => one.node)), start),
    problem.node, algorithm.node,
    h("details.card", null, h("summary", null, "Advanced: priority, repeats, execution"), h("div.fields", null, [...further, ...execution].map((one) => one.node))));

  function read() {
    const document = { ...kept, problem: problem.read(), algorithm: algorithm.read(), budget: {} };
    const ran = {};
    for (const one of own) {
      const value = one.read();
      if (value === undefined) continue;
      if (one.pointer === "/budget/simulations") document.budget.simulations = value;
      else document[one.pointer.slice(1)] = value;
    }
    for (const one of execution) if (one.read() !== undefined) ran[one.pointer.split("/").at(-1)] = one.read();
    if (Object.keys(ran).length) document.execution = ran;
    return document;
  }

  function fill(body) {
    kept = Object.fromEntries(["llm", "start_from", "tags", "notes"].filter((name) => body[name]?.length !== 0 && body[name]).map((name) => [name, body[name]]));
    showStart();
    for (const one of own) one.fill(one.pointer === "/budget/simulations" ? body.budget?.simulations : body[one.pointer.slice(1)]);
    for (const one of execution) one.fill(body.execution?.[one.pointer.split("/").at(-1)]);
    problem.fill(body.problem);
    algorithm.fill(body.algorithm);
  }

  /** Say what the campaign starts from, which has no field. */
  function showStart() {
    const { start_from: from } = kept;
    start.hidden = !from;
    text(start.firstChild, !from ? "" : from.campaign
      ? `It starts from the ${from.results === false ? "solutions" : "results"} of campaign ${from.campaign}.` : `It starts from ${from.solutions.length} given solutions.`);
  }

  /** Show errors next to their fields; returns those that belong to none. */
  function complain(errors) {
    const rest = [];
    const fields = every();
    for (const one of fields) one.complain("");
    let first = null;
    for (const error of errors) {
      const place = fields.find((one) => error.pointer === one.pointer || error.pointer?.startsWith(`${one.pointer}/`));
      if (!place) rest.push(error);
      else {
        place.complain(error.nearest ? `${sentence(error.message)} Did you mean ${error.nearest}?` : error.message);
        place.node.closest("details")?.setAttribute("open", "");
        first ??= place;
      }
    }
    first?.focus();
    return rest;
  }

  return { node, read, fill, complain };
}

/** Return the part of the form for a plug-in and its parameters; ``told`` is called with the plug-in, or null if it is unknown. */
function plugin(part, title, known, first, told = () => {}) {
  const select = h("select", { id: `choose-${part}`, onchange: () => {
    byHand = true;
    choose(select.value);
  } }, known.map((one) => h("option", { value: one.id }, plainId(one.id))));
  const summary = h("p.help", { id: `about-${part}` });
  select.setAttribute("aria-describedby", `about-${part}`);
  const wrong = h("p.wrong", { role: "alert", hidden: true });
  const place = h("div.fields");
  const prominent = h("div.prominent");
  const more = h("details", null, h("summary", null, `Parameters of the ${part}`), place);
  const node = h("fieldset.card", null, h("legend", null, title),
    h("div.fields", null, h("div.field", null, h("label", { for: `choose-${part}` }, title), select, summary, wrong), prominent), more);
  let fields = [];
  let unknown = {}; // parameters of a plug-in that is not installed here
  let suggested = {}; // defaults that are not the schema's
  let byHand = false; // whether somebody has chosen it

  function choose(id) {
    unknown = {};
    const chosen = known.find((one) => one.id === id) ?? null;
    if (![...select.options].some((one) => one.value === id)) select.append(h("option", { value: id }, id)); // the server validates it
    select.value = id;
    text(summary, chosen?.summary ?? "");
    const properties = chosen?.params.properties ?? {};
    fields = Object.entries(properties).map(([name, schema]) => {
      const pointer = `/${part}/params/${name}`;
      return schema.by_parameter ? byParameter(schema, pointer, chosen.space) : field(name, schema, pointer);
    });
    suggest(suggested);
    replace(prominent, fields.filter((one) => one.main).map((one) => one.node));
    replace(place, fields.filter((one) => !one.main).map((one) => one.node));
    more.hidden = !place.firstChild;
    told(chosen);
  }

  function fill(given) {
    byHand = true;
    choose(given?.id ?? first);
    if (!known.some((one) => one.id === given?.id)) unknown = given?.params ?? {};
    for (const one of fields) one.fill(given?.params?.[one.pointer.split("/").at(-1)]);
    if (fields.some((one) => !one.main && one.read() !== undefined)) more.open = true;
  }

  function read() {
    const params = Object.fromEntries(fields.map((one) => [one.pointer.split("/").at(-1), one.read()]).filter(([, value]) => value !== undefined));
    return { id: select.value, params: { ...unknown, ...params } };
  }

  /** Show defaults that replace the schema's. */
  function suggest(defaults) {
    suggested = defaults;
    for (const one of fields) one.suggest(suggested[one.pointer.split("/").at(-1)]);
  }

  /** Choose another plug-in, unless somebody has chosen one. */
  function follow(id) {
    if (!byHand && id !== undefined && id !== select.value) choose(id);
  }

  choose(known.some((one) => one.id === first) ? first : known[0].id);
  return {
    node,
    fields: () => [...fields, { pointer: `/${part}/id`, node: select, focus: () => select.focus(), complain: (message) => { text(wrong, message); wrong.hidden = !message; } }],
    read, fill, suggest, follow,
  };
}

/** Return the name of a field as in a campaign file, from its JSON pointer. */
function fieldName(pointer) {
  const parts = pointer.split("/").slice(1).map((part) => part.replaceAll("~1", "/").replaceAll("~0", "~"));
  return parts.map((part) => (/^\d+$/.test(part) ? `[${part}]` : `.${part}`)).join("").replace(/^\./, "");
}
