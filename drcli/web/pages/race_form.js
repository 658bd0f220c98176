// The form with all rules of a race, to make one or to change one. What it comes to is checked while it is filled.

import { SelectField, TextField, leadTo, useChecked } from "/fields.js";
import { aboutField } from "/race_words.js";
import { DraftNote } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { Button, Failure, Prose, html, useEffect, useRef, useState } from "/ui.js";

const CHECK_MS = 350;
const SLOW_MS = 2000;

/** Whether a rule has no meaning for this kind of race. */
const isHidden = ({ only }, { race_type: kind }) => only.length > 0 && !only.includes(kind);
const isNumber = ({ kind }) => kind === "whole" || kind === "seconds";

function localTime(unix) {
  if (!unix) return "";
  const at = new Date(unix * 1000);
  return new Date(Number(at) - at.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
}

/** What a control begins with. */
const startOf = (field) =>
  field.kind === "time"
    ? localTime(field.value)
    : isNumber(field)
      ? String(field.value ?? "")
      : field.value;

/** The rules as the server takes them, and what no server needs to say about them. */
function rulesOf(fields, values) {
  const rules = {};
  const wrong = [];
  for (const field of fields) {
    const { key, kind, label } = field;
    rules[key] = values[key];
    if (kind === "time") rules[key] = values[key] ? new Date(values[key]).toISOString() : "";
    if (!isNumber(field)) continue;
    const text = isHidden(field, values) ? "" : values[key].trim();
    const seconds = kind === "seconds";
    rules[key] = text === "" ? null : Number(text);
    if (seconds ? Number.isFinite(rules[key]) : Number.isSafeInteger(rules[key] ?? 0)) continue;
    wrong.push({
      severity: "error",
      key,
      message: `“${label}” is not a ${seconds ? "" : "whole "}number.`,
      remedy: `Write digits, such as ${seconds ? "2.5" : "3"}.`,
    });
  }
  return { rules, wrong };
}

/**
 * @param {{title: string, action: string, draft: Object, path?: string, present?: boolean, send: (rules: Object) => Promise<void>, leave: () => void}} props
 *   path: where the fields are; present: they have the rules of a race
 */
export function RaceForm(props) {
  const { title, draft, path = "/api/races/form", present = false } = props;
  const { value, error } = useGet(path);
  return html`
    <section class="race-card" aria-label=${title}>
      <h2>${title}</h2>
      ${present && html`<p class="quiet">As long as nobody has driven.</p>`}
      <${DraftNote} draft=${draft} />
      ${error ? html`<${Failure} error=${error} />` : value ? html`<${Form} fields=${value.fields} ...${props} />` : html`<p class="quiet">Reading the tracks …</p>`}
    </section>`;
}

function Form({ fields, present = false, action, draft, send, leave }) {
  const form = useRef(null);
  const [refused, setRefused] = useState(null);
  const [slow, setSlow] = useState(false);
  const start = Object.fromEntries(fields.map((field) => [field.key, startOf(field)]));
  const labels = Object.fromEntries(fields.map(({ key, label }) => [key, label]));
  const values = { ...start, ...draft.edits };
  const { rules, wrong } = rulesOf(fields, values);
  const named = values.name.trim() !== "";
  const checked = useChecked(
    "/api/races/check",
    named && !wrong.length ? rules : null,
    present || draft.restored ? 0 : CHECK_MS,
  );
  const told = refused ?? (checked.error && aboutField(checked.error));
  const problems = told ? [...wrong, told] : wrong;
  useEffect(() => form.current.querySelector("input").focus(), []);

  const set = (key, value) => {
    setRefused(null);
    const edits = { ...draft.edits, [key]: value };
    if (JSON.stringify(value) === JSON.stringify(start[key])) delete edits[key];
    draft.set(edits);
  };
  const refuse = (about) => {
    setRefused(about);
    leadTo(about);
  };
  const [submit, busy] = useAction(async () => {
    const broken = form.current.querySelector("input:invalid")?.closest("[data-key]")?.dataset.key;
    if (wrong.length) return leadTo(wrong[0]);
    if (broken || !named)
      return refuse({
        ...{ severity: "error", key: broken ?? "name", remedy: "" },
        message: broken ? `“${labels[broken]}” is not a complete time.` : "Give the race a name.",
      });
    const timer = setTimeout(() => setSlow(true), SLOW_MS);
    try {
      await send(rules);
      draft.saved(values);
    } catch (error) {
      refuse(aboutField(error));
    } finally {
      clearTimeout(timer);
      setSlow(false);
    }
  });

  const tick = (label, checked, change) => html`
    <label key=${label} class="form-check"><input type="checkbox" checked=${checked}
      onChange=${(event) => change(event.currentTarget.checked)} /> ${label}</label>`;
  const control = (field) => {
    const { key, label, kind, options } = field;
    const change = (value) => set(key, value);
    const value = values[key];
    if (kind === "flag") return tick(label, value, change);
    if (kind === "many")
      return html`
        <div role="group" aria-label=${label} data-key=${key}>
          <p class="race-label">${label} (none chosen: any)</p>
          <div class="race-checks">${options.map((name) =>
            tick(name, value.includes(name), (on) =>
              change(on ? [...value, name] : value.filter((each) => each !== name)),
            ),
          )}</div>
        </div>`;
    const common = {
      ...{ key, label, value, "data-key": key, hidden: isHidden(field, values) },
      help: key === "name" && present ? "The id of the race stays." : field.help,
      problems: problems.filter((each) => each.key === key),
    };
    if (kind === "choice")
      return html`<${SelectField} ...${common} options=${options} onChange=${change} />`;
    const numeric = isNumber(field);
    return html`<${TextField} ...${common} type=${kind === "time" ? "datetime-local" : "text"} numeric=${numeric} onInput=${change} placeholder=${numeric ? field.empty : null} />`;
  };
  const parts = Object.entries(Object.groupBy(fields, ({ part }) => part));
  const isBox = ({ kind }) => kind === "flag" || kind === "many";
  return html`
    <form ref=${form} class="race-form" novalidate aria-label=${action} onSubmit=${(event) => {
      event.preventDefault();
      submit();
    }}>
      ${parts.map(
        ([name, own]) => html`
          <fieldset key=${name}><legend>${name}</legend>
            <div class="fields">${own.filter((field) => !isBox(field)).map(control)}</div>
            ${own.filter(isBox).map(control)}
          </fieldset>`,
      )}
      <div class="race-outcome" role="status"><${Outcome} ...${{ slow, named, problems, present, labels }} answer=${checked.answer} /></div>
      <p class="actions">
        <button type="submit" class="main" aria-disabled=${busy ? "true" : null}>${action}</button>
        <${Button} onClick=${() => {
          draft.set({});
          leave();
        }}>Cancel<//>
      </p>
    </form>`;
}

/** What the rules come to, or what stands in the way. */
function Outcome({ slow, named, problems, answer, present, labels }) {
  if (slow)
    return html`<p class="quiet">The bucket is being opened. This can take a minute if another command is starting or stopping its server; the form stays filled in.</p>`;
  if (problems.length) {
    const [first] = problems;
    if (!labels[first.key]) return html`<${Failure} error=${first} />`;
    return html`<p class="race-failed">Correct the field “${labels[first.key]}” first.</p>`;
  }
  if (!named) return html`<p class="quiet">Give the race a name.</p>`;
  if (!answer) return html`<p class="quiet">Your rules appear here as a sentence.</p>`;
  const { rules, words } = answer;
  return html`
    <p><strong>${rules.name}: </strong>${rules.world}${rules.reverse && ", opposite direction"}, ${words.kind}. ${words.decides} ${words.penalties}</p>
    <p class="quiet">Its id will be ${present ? "the same as before" : answer.race || "drawn"}. ${words.conditions && html`Settings that the race keeps: <${Prose} text=${words.conditions} />.`}</p>`;
}
