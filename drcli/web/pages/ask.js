// A dialog with fields and one action.

import { dialog } from "/dialogs.js";
import { Field, SelectField } from "/fields.js";
import { html, useState } from "/ui.js";

/**
 * @typedef {Object} AskedField
 * @property {string} name
 * @property {string} label
 * @property {any} value what it begins with; true or false for a check box
 * @property {(string | string[])[]} [options] of a choice
 * @property {string} [help]
 * @property {boolean} [lines] several lines of text
 * @property {Object} [more] attributes of the control, such as min and required
 * @property {(values: Object) => boolean} [hidden]
 */

const control = (field, values, set) => {
  const { name, label, options, help, lines, more = {} } = field;
  const common = { key: name, label, help, hidden: field.hidden?.(values) ?? false };
  const change = (value) => set({ ...values, [name]: value });
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

function Form({ title, intro, fields, action, danger, ready, close }) {
  const [values, setValues] = useState(
    Object.fromEntries(fields.map(({ name, value }) => [name, value])),
  );
  const submit = (event) => {
    event.preventDefault();
    close(values);
  };
  return html`
    <form class="ask" onSubmit=${submit}>
      <h2 id="ask-title">${title}</h2>
      ${intro}
      ${fields.map((field) => control(field, values, setValues))}
      <p class="actions">
        <button type="button" onClick=${() => close(null)}>Cancel</button>
        <button type="submit" class=${danger ? "danger" : "main"} disabled=${!ready(values)}>${action}</button>
      </p>
    </form>`;
}

/**
 * Ask for values.
 * @param {{title: string, action: string, intro?: any, fields: (AskedField | null | false)[], danger?: boolean, ready?: (values: Object) => boolean}} spec
 * @returns {Promise<Object | null>} values by name; null if it was left
 */
export function ask({ intro = null, fields, danger = false, ready = () => true, ...spec }) {
  const props = { ...spec, intro, fields: fields.filter(Boolean), danger, ready };
  return dialog((close) => html`<${Form} ...${props} close=${close} />`, { label: "ask-title" });
}
