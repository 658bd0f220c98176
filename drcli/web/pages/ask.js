// A dialog with fields and one action. What was typed is kept until it was taken, or cancelled.

import { dialog } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { Field, SelectField } from "/fields.js";
import { DraftNote } from "/steps.js";
import { route, useAction } from "/store.js";
import { Failure, html, useState } from "/ui.js";

/**
 * @typedef {Object} AskedField
 * @property {string} name
 * @property {string} label
 * @property {any} value what it begins with; true or false for a check box
 * @property {(string | string[])[]} [options] of a choice
 * @property {string} [help]
 * @property {boolean} [lines] several lines of text
 * @property {Object} [more] attributes of the control, such as min and required
 * @property {string[]} [only] name and value of another field that it belongs to
 * @property {string} [on] what is given for a check box that is ticked
 * @property {string} [list] the list to which the name of a ticked check box belongs
 */

const isHidden = ({ only }, values) => Boolean(only) && values[only[0]] !== only[1];

/** What was chosen; numbers as such, null for none. */
function given(fields, values) {
  const found = {};
  for (const field of fields) {
    const { name, on, list, more } = field;
    const value = values[name];
    if (isHidden(field, values)) continue;
    if (list) found[list] = [...(found[list] ?? []), ...(value ? [name] : [])];
    else if (on) found[name] = value ? on : "";
    else if (more?.type === "number") found[name] = value === "" ? null : Number(value);
    else found[name] = value;
  }
  return found;
}

const control = (field, values, set, refused) => {
  const { name, label, options, help, lines, more = {} } = field;
  const problems = refused?.key === name ? [refused] : [];
  const common = { key: name, label, help, problems, hidden: isHidden(field, values) };
  const change = (value) => set(name, value);
  if (typeof field.value === "boolean")
    return html`<p key=${name}><label class="form-check">
      <input type="checkbox" checked=${values[name]} onChange=${(event) => change(event.currentTarget.checked)} /> ${label}
    </label></p>`;
  if (options)
    return html`<${SelectField} ...${common} options=${options} value=${values[name]} onChange=${change} />`;
  if (lines)
    return html`<${Field} ...${common} control=${(
      own,
    ) => html`<textarea ...${own} rows="5" value=${values[name]} ...${more}
      onInput=${(event) => change(event.currentTarget.value)}></textarea>`} />`;
  return html`<${Field} ...${common} control=${(
    own,
  ) => html`<input ...${own} autocomplete="off" spellcheck=${false} value=${values[name]} ...${more}
    onInput=${(event) => change(event.currentTarget.value)} />`} />`;
};

function Form({ title, intro, fields, action, danger, confirm, send, close }) {
  const draft = useDraft(confirm === null ? `ask:${route.value.path}:${title}` : null, null);
  const start = Object.fromEntries(fields.map(({ name, value }) => [name, value]));
  const values = { ...start, ...draft.edits };
  const [refused, setRefused] = useState(null);
  const set = (name, value) => {
    setRefused(null);
    const { [name]: _, ...others } = draft.edits;
    draft.set(value === start[name] ? others : { ...others, [name]: value });
  };
  const leave = (value) => {
    draft.set({});
    close(value);
  };
  const [submit, busy] = useAction(async () => {
    const found = given(fields, values);
    try {
      leave(send ? await send(found) : found);
    } catch (error) {
      const { message } = error;
      setRefused({ severity: "error", key: "", message, ...error, ...error.problems?.[0] });
    }
  });
  return html`
    <form class="ask" onSubmit=${(event) => {
      event.preventDefault();
      submit();
    }}>
      <h2 id="ask-title">${title}</h2>
      ${typeof intro === "string" ? html`<p>${intro}</p>` : intro}
      ${fields.map((field) => control(field, values, set, refused))}
      <${DraftNote} draft=${draft} />
      ${refused && !(refused.key in start) && html`<${Failure} error=${refused} />`}
      <p class="actions">
        <button type="button" onClick=${() => leave(null)}>Cancel</button>
        <button type="submit" class=${danger ? "danger" : "main"} aria-disabled=${busy ? "true" : null}
          disabled=${confirm !== null && values.confirm !== confirm}>${action}</button>
      </p>
    </form>`;
}

/**
 * Ask for values.
 * @param {{title: string, action: string, intro?: any, fields: (AskedField | null | false)[], danger?: boolean, confirm?: string | null,
 *   send?: ((values: Object) => Promise<any>) | null}} spec `confirm`: what must be typed into the field of that name; `send`
 *   takes the values: what it refuses is said in the dialog, which stays
 * @returns {Promise<any>} values by name, or the answer of `send`; null if it was left
 */
export function ask({
  intro = null,
  fields,
  danger = false,
  confirm = null,
  send = null,
  ...spec
}) {
  const props = { ...spec, intro, fields: fields.filter(Boolean), danger, confirm, send };
  return dialog((close) => html`<${Form} ...${props} close=${close} />`, { label: "ask-title" });
}
