// Hyperparameters: each with its explanation, limits and problems.

import { get, post } from "/api.js";
import { fill, h, prose } from "/dom.js";
import { brokenFile, editStep, savedText, writeOwnFile } from "/edit_step.js";
import { debounced } from "/setting_fields.js";

const PATH = "/api/hyperparameters";
const USUAL = [
  "batch_size",
  "num_epochs",
  "lr",
  "beta_entropy",
  "discount_factor",
  "loss_type",
  "num_episodes_between_training",
  "exploration_type",
  "training_method",
];

/** The step; `facts` is the answer of /api/hyperparameters, `algorithm` tells the chosen one. */
export function hyperparameterStep(facts, { algorithm, saved }, signal) {
  const rows = new Map();
  const later = debounced(check, 400, signal);
  const usual = h("div", { class: "fields" }),
    more = h("div", { class: "fields" });
  const step = editStep(
    {
      id: "hyperparameters",
      title: "Hyperparameters",
      hint: "How the model learns. An empty field leaves the key out of hyperparameters.json.",
      save,
    },
    usual,
    h("details", {}, h("summary", {}, "All other hyperparameters"), more),
  );

  for (const key of facts.keys) {
    const row = fieldOf(key);
    rows.set(key.key, row);
    const own = key.algorithms.some((name) => key.key.startsWith(`${name}_`));
    (own || USUAL.includes(key.key) ? usual : more).append(row.element);
  }
  showValues(facts.values);
  show(facts.problems);
  brokenFile(step, facts, PATH, reread, signal);
  async function reread() {
    Object.assign(facts, await get(PATH, signal));
    showValues(facts.values);
    show(facts.problems);
    brokenFile(step, facts, PATH, reread, signal);
    step.mark(false, "");
  }

  function fieldOf(key) {
    const id = `key-${key.key}`,
      problem = h("p", { class: "field-problem", id: `${id}-problem`, role: "status" });
    const common = { id, "aria-describedby": `${id}-help ${id}-problem` };
    const change = () => {
      step.mark(isChanged(), isChanged() ? null : "");
      later();
    };
    const left = `left out: ${key.left_out}`;
    const options = key.kind === "flag" ? ["true", "false"] : key.choices;
    const control = options.length
      ? h(
          "select",
          { ...common, change },
          h("option", { value: "" }, left),
          options.map((value) => h("option", { value }, value)),
        )
      : h("input", {
          ...common,
          type: "text",
          inputmode: "decimal",
          autocomplete: "off",
          placeholder: left,
          input: change,
        });
    const limits =
      key.low !== null && key.high !== null
        ? `From ${key.low} to ${key.high}.`
        : key.low !== null
          ? `${key.low} or more.`
          : "";
    const element = h(
      "div",
      { class: "field" },
      h("label", { for: id }, h("code", {}, key.key)),
      control,
      h(
        "p",
        { class: "help", id: `${id}-help` },
        `${key.meaning} ${limits} ${key.shipped ? `Shipped: ${key.shipped}. ` : ""}${key.effect ? "" : "No effect."}`,
      ),
      problem,
      key.higher || key.advice
        ? h(
            "details",
            { class: "small" },
            h("summary", {}, `What a change of ${key.key} does`),
            h(
              "dl",
              {},
              [
                [key.lower ? "Higher" : "Effect", key.higher],
                ["Lower", key.lower],
                ["Advice", key.advice],
              ]
                .filter(([, text]) => text)
                .map(([name, text]) => [h("dt", {}, name), h("dd", {}, text)]),
            ),
          )
        : null,
    );
    return { key, control, element, problem };
  }
  function showValues(values) {
    for (const row of rows.values()) {
      const value = values[row.key.key];
      const text =
        value === undefined || value === null
          ? ""
          : typeof value === "string"
            ? value
            : JSON.stringify(value);
      if (
        row.control.tagName === "SELECT" &&
        text &&
        ![...row.control.options].some((each) => each.value === text)
      )
        row.control.append(h("option", { value: text }, text));
      row.control.value = row.start = text;
    }
  }
  /** The value of a field as the file has it; text that is no number stays text, and the check says so. */
  function valueOf({ key, control }) {
    const text = control.value.trim();
    if (text === "") return null;
    if (key.kind === "flag") return text === "true" ? true : text === "false" ? false : text;
    if (key.kind === "whole" || key.kind === "number")
      return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(text) ? Number(text) : text;
    return text;
  }
  const changes = () =>
    Object.fromEntries(
      [...rows.values()]
        .filter((row) => row.control.value !== row.start)
        .map((row) => [row.key.key, valueOf(row)]),
    );
  const isChanged = () => Object.keys(changes()).length > 0;

  function show(found) {
    for (const row of rows.values()) {
      const mine = found.filter((each) => each.key === row.key.key);
      fill(
        row.problem,
        mine.map((each) =>
          h(
            "span",
            { class: each.severity === "error" ? "bad" : "warn" },
            prose(`${each.message} ${each.remedy} `),
          ),
        ),
      );
      row.control.setAttribute(
        "aria-invalid",
        String(mine.some((each) => each.severity === "error")),
      );
    }
    step.problems(found.filter((each) => !rows.has(each.key)));
  }
  async function check() {
    try {
      show((await post(`${PATH}/check`, { values: changes() }, signal)).problems);
    } catch (error) {
      if (error.name !== "AbortError") step.failed(error);
    }
  }
  async function save() {
    const answer = await writeOwnFile(
      PATH,
      { values: changes(), version: facts.version },
      {
        mine: JSON.stringify({ ...facts.values, ...changes() }, null, 2),
        read: () => get(PATH, signal),
        signal,
      },
    );
    if (!answer) {
      step.mark(true, "Not saved.");
      return;
    }
    Object.assign(facts, answer.disk ?? answer);
    showValues(facts.values);
    step.mark(false, answer.disk ? "Taken from the disk." : savedText(answer));
    await check();
    saved();
  }
  /** Show only the keys of the chosen algorithm. */
  step.refresh = () => {
    for (const row of rows.values()) row.element.hidden = !row.key.algorithms.includes(algorithm());
    later();
  };
  step.lead = (problem) => {
    const row = rows.get(problem.key);
    if (!row) return false;
    row.element.hidden = false;
    if (row.element.closest("details")) row.element.closest("details").open = true;
    row.control.focus();
    row.element.scrollIntoView({ block: "center" });
    return true;
  };
  for (const row of rows.values()) row.element.hidden = !row.key.algorithms.includes(algorithm());
  return step;
}
