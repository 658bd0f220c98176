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

const control = (field, values, set) => {
  const { name, label, options, help, lines, more = {} } = field;
  const common = { key: name, label, help, hidden: isHidden(field, values) };
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

function Form({ title, intro, fields, action, danger, confirm, close }) {
  const [values, setValues] = useState(
    Object.fromEntries(fields.map(({ name, value }) => [name, value])),
  );
  const submit = (event) => {
    event.preventDefault();
    close(given(fields, values));
  };
  return html`
    <form class="ask" onSubmit=${submit}>
      <h2 id="ask-title">${title}</h2>
      ${typeof intro === "string" ? html`<p>${intro}</p>` : intro}
      ${fields.map((field) => control(field, values, setValues))}
      <p class="actions">
        <button type="button" onClick=${() => close(null)}>Cancel</button>
        <button type="submit" class=${danger ? "danger" : "main"} disabled=${confirm !== null && values.confirm !== confirm}>${action}</button>
      </p>
    </form>`;
}

/**
 * Ask for values.
 * @param {{title: string, action: string, intro?: any, fields: (AskedField | null | false)[], danger?: boolean, confirm?: string | null}} spec `confirm`: what must be typed into the field of that name
 * @returns {Promise<Object | null>} values by name; null if it was left
 */
export function ask({ intro = null, fields, danger = false, confirm = null, ...spec }) {
  const props = { ...spec, intro, fields: fields.filter(Boolean), danger, confirm };
  return dialog((close) => html`<${Form} ...${props} close=${close} />`, { label: "ask-title" });
}
