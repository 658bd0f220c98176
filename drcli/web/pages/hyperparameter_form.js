// Hyperparameters: each with its explanation, limits and problems.

import { useDraft } from "/drafts.js";
import { Field, useChecked } from "/fields.js";
import { BrokenFile, Step, useFileSaving } from "/steps.js";
import { html } from "/ui.js";

const PATH = "/api/hyperparameters";
const textOf = (value) =>
  (value ?? null) === null ? "" : typeof value === "string" ? value : JSON.stringify(value);

/** The value as the file has it; text that is not a number stays text, and the check says so. */
function valueOf({ kind }, text) {
  const word = text.trim();
  if (word === "") return null;
  if (kind === "flag") return { true: true, false: false }[word] ?? word;
  if (kind === "whole" || kind === "number")
    return /^[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$/i.test(word) ? Number(word) : word;
  return word;
}

/**
 * @param {{facts: Object, reload: () => Promise<void>, folder: string, algorithm: string, saved: () => void}} props
 *   `facts` is the answer of /api/hyperparameters, `algorithm` the chosen one
 */
export function HyperparameterStep({ facts, reload, folder, algorithm, saved }) {
  const draft = useDraft(`${folder}/hyperparameters`, facts.version);
  const { edits } = draft;
  const edited = facts.keys.filter(({ key }) => edits[key] !== undefined);
  const values = Object.fromEntries(
    edited.map((each) => [each.key, valueOf(each, edits[each.key])]),
  );
  const dirty = edited.length > 0;
  const checked = useChecked(`${PATH}/check`, { values, algorithm }, 400, {}, facts.version);
  const problems = checked.answer?.problems ?? facts.problems;
  const mine = JSON.stringify({ ...facts.values, ...values }, null, 2);
  const body = { values };
  const saving = useFileSaving(dirty, { path: PATH, draft, edits, body, mine, reload, saved });
  const field = ({ key, help, options, placeholder, effects, algorithms }) => {
    const start = textOf(facts.values[key]);
    const value = edits[key] ?? start;
    const isKnown = !value || options?.flat().includes(value);
    return html`
      <${Field} key=${key} label=${html`<code>${key}</code>`} place=${key} help=${help} placeholder=${placeholder}
        options=${options && (isKnown ? options : [...options, value])} numeric=${!options} value=${value}
        set=${(text) => draft.change(key, text, start)} hidden=${!algorithms.includes(algorithm)}
        problems=${problems.filter((each) => each.key === key)}>
        ${
          effects.length > 0 &&
          html`<details class="small">
            <summary>What a change of ${key} does</summary>
            <dl>${effects.map(([name, text]) => html`<dt>${name}</dt><dd>${text}</dd>`)}</dl>
          </details>`
        }
      <//>`;
  };
  const known = new Set(facts.keys.map(({ key }) => key));
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
