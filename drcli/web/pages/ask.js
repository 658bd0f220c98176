// A dialog with fields and one action. What was typed is kept until it was taken, or cancelled.

import { dialog } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { Fields, readFields, startOf } from "/fields.js";
import { DraftNote } from "/steps.js";
import { route, useAction } from "/store.js";
import { Button, Failure, Form, html, useEffect, useState } from "/ui.js";

/**
 * What the server refuses, and the field of a form that it is about.
 * @param {any} error
 */
export const aboutField = ({ message, remedy = "", key = "", problems = [] }) => ({
  ...{ severity: "error", key, message, remedy },
  ...problems[0],
});

function Asked({ title, intro, fields: first, action, danger, confirm, ...more }) {
  const { about, again, send, close } = more;
  const name = `ask:${route.value.path}:${title}:${about}`;
  const draft = useDraft(confirm === null ? name : null, null);
  const [fields, setFields] = useState(first);
  const [refused, setRefused] = useState(null);
  const start = startOf(fields);
  const values = { ...start, ...draft.edits };
  const chosen = again && values[again.name];
  useEffect(() => {
    if (!again || chosen === start[again.name]) return undefined;
    let isNewest = true;
    again.fields(chosen).then(
      (found) => isNewest && setFields(found),
      (error) => isNewest && setRefused(aboutField(error)),
    );
    return () => {
      isNewest = false;
    };
  }, [chosen]);
  const set = (name, value) => {
    setRefused(null);
    draft.change(name, value, start[name]);
    // What comes after the choice of other fields is about it.
    if (name === again?.name)
      for (const each of fields.slice(fields.findIndex((field) => field.name === name) + 1))
        draft.change(each.name, null, null);
  };
  const leave = (value) => {
    draft.set({});
    close(value);
  };
  const [submit, busy] = useAction(async () => {
    const { given } = readFields(fields, values);
    try {
      leave(send ? await send(given) : given);
    } catch (error) {
      setRefused(aboutField(error));
    }
  });
  return html`
    <${Form} class="ask" aria-busy=${String(busy)} onSubmit=${submit}>
      <h2 id="ask-title">${title}</h2>
      ${typeof intro === "string" ? html`<p>${intro}</p>` : intro}
      <${Fields} fields=${fields} values=${values} set=${set} problems=${refused ? [refused] : []} />
      <${DraftNote} draft=${draft} />
      ${refused && !(refused.key in start) && html`<${Failure} error=${refused} />`}
      <p class="actions">
        <${Button} busy=${busy} onClick=${() => leave(null)}>Cancel<//>
        <${Button} type="submit" class=${danger ? "danger" : "main"} busy=${busy} disabled=${confirm !== null && values.confirm !== confirm}>${action}<//>
      </p>
      <p class="quiet" role="status">${busy && "Waiting for the answer ..."}</p>
    <//>`;
}

/**
 * Ask for values.
 * @param {{title: string, action: string, intro?: any, fields: import("./fields.js").Described[], danger?: boolean, confirm?: string | null,
 *   about?: string, again?: {name: string, fields: (value: string) => Promise<any[]>} | null, send?: ((values: Object) => Promise<any>) | null}} spec
 *   `confirm`: what must be typed into the field of that name; `about`: whose draft it is, if the title does not say; `again`: a field, and what the fields are for its value;
 *   `send` takes the values: what it refuses is said in the dialog, which stays
 * @returns {Promise<any>} values by name, or the answer of `send`; null if it was left
 */
export function ask({ intro = null, danger = false, confirm = null, about = "", ...spec }) {
  const props = { again: null, send: null, ...spec, intro, danger, confirm, about };
  return dialog((close) => html`<${Asked} ...${props} close=${close} />`, { label: "ask-title" });
}

/**
 * Ask before something that cannot be undone.
 * @param {string} question
 * @param {{action: string, detail?: any}} options
 * @returns {Promise<boolean>}
 */
export const confirmed = async (question, { action, detail = null }) =>
  (await ask({ title: question, intro: detail, action, danger: true, fields: [] })) !== null;
