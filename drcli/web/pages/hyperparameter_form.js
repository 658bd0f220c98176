// Hyperparameters: each with its explanation, limits and problems.

import { useDraft } from "/drafts.js";
import { SelectField, TextField, useChecked } from "/fields.js";
import { BrokenFile, Step, useFileSaving } from "/steps.js";
import { html } from "/ui.js";

const PATH = "/api/hyperparameters";
const textOf = (value) =>
  (value ?? null) === null ? "" : typeof value === "string" ? value : JSON.stringify(value);

/** The value as the file has it; text that is not a number stays text, and the check says so. */
function valueOf({ kind }, text) {
  const word = text.trim();
  if (word === "") return null;
  if (kind === "flag") return word === "true" ? true : word === "false" ? false : word;
  if (kind === "whole" || kind === "number")
    return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(word) ? Number(word) : word;
  return word;
}

function KeyField({ about, value, onInput, problems, hidden }) {
  const { key, choices, effects, left_out: left } = about;
  const common = {
    label: html`<code>${key}</code>`,
    help: about.help,
    value,
    problems,
    hidden,
    "data-key": key,
  };
  const more =
    effects.length > 0 &&
    html`<details class="small">
      <summary>What a change of ${key} does</summary>
      <dl>${effects.map(([name, text]) => html`<dt>${name}</dt><dd>${text}</dd>`)}</dl>
    </details>`;
  if (!choices.length)
    return html`<${TextField} ...${common} numeric=${true} placeholder=${left} onInput=${onInput}>${more}<//>`;
  const known = [["", left], ...choices, ...(value && !choices.includes(value) ? [value] : [])];
  return html`<${SelectField} ...${common} options=${known} onChange=${onInput}>${more}<//>`;
}

/**
 * @param {{facts: Object, reload: () => Promise<void>, folder: string, algorithm: string, saved: () => void}} props
 *   `facts` is the answer of /api/hyperparameters, `algorithm` the chosen one
 */
export function HyperparameterStep({ facts, reload, folder, algorithm, saved }) {
  const draft = useDraft(`${folder}/hyperparameters`, facts.version);
  const { edits } = draft;
  const start = (about) => textOf(facts.values[about.key]);
  const keys = facts.keys.filter((about) => edits[about.key] !== undefined);
  const values = Object.fromEntries(
    keys.map((about) => [about.key, valueOf(about, edits[about.key])]),
  );
  const dirty = keys.length > 0;
  const checked = useChecked(`${PATH}/check`, { values, algorithm }, 400, {}, facts.version);
  const problems = checked.answer?.problems ?? facts.problems;
  const mine = JSON.stringify({ ...facts.values, ...values }, null, 2);
  const saving = useFileSaving(dirty, {
    path: PATH,
    draft,
    edits,
    body: { values },
    mine,
    reload,
    saved,
  });
  const set = (about, text) => {
    const { [about.key]: _, ...others } = edits;
    draft.set(text === start(about) ? others : { ...others, [about.key]: text });
  };
  const field = (
    about,
  ) => html`<${KeyField} key=${about.key} about=${about} value=${edits[about.key] ?? start(about)}
    onInput=${(text) => set(about, text)} hidden=${!about.algorithms.includes(algorithm)}
    problems=${problems.filter((each) => each.key === about.key)} />`;
  const known = new Set(facts.keys.map((about) => about.key));
  return html`
    <${Step} id="hyperparameters" title="Hyperparameters" dirty=${dirty} saving=${saving} draft=${draft}
      hint="How the model learns. An empty field leaves the key out of hyperparameters.json."
      problems=${problems.filter((each) => !known.has(each.key))}>
      <${BrokenFile} facts=${facts} path=${PATH} again=${reload} />
      <div class="fields">${facts.keys.filter(({ usual }) => usual).map(field)}</div>
      <details>
        <summary>All other hyperparameters</summary>
        <div class="fields">${facts.keys.filter(({ usual }) => !usual).map(field)}</div>
      </details>
    <//>`;
}
