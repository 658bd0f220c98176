// The notes of a model: read, write, edit, remove.

import { post, put, remove } from "/api.js";
import { ask, confirmed } from "/ask.js";
import { DraftNote } from "/steps.js";
import { useDraft } from "/drafts.js";
import { Field } from "/fields.js";
import { useAction, useGet } from "/store.js";
import { moment } from "/text.js";
import { Button, Empty, Failure, Form, html } from "/ui.js";

/** @param {{prefix: string, path: (name: string) => string, version: any}} props */
export function Notes({ prefix, path: pathOf, version }) {
  const path = pathOf("notes");
  const { value: found, error, reload } = useGet(path, version);
  const draft = useDraft(`note/${prefix}`, null);
  const [send] = useAction(async (action) => {
    await action();
    reload();
  });
  const text = draft.edits.text ?? "";
  const add = () =>
    send(async () => {
      await post(path, { text });
      draft.saved({ text });
    });
  const edit = async ({ number, text: before }) => {
    const changed = await ask({
      title: number === 0 ? `Describe ${prefix}` : `Edit note ${number} of ${prefix}`,
      action: "Save",
      about: before,
      fields: [
        { name: "text", label: "Text", value: before, kind: "lines", more: { required: true } },
      ],
      send: ({ text: written }) => put(path, { number, text: written }),
    });
    if (changed) reload();
  };
  const drop = async (note) => {
    if (await confirmed("Remove this note?", { action: "Remove", detail: note.text }))
      send(() => remove(`${path}&number=${note.number}`));
  };
  if (error) return html`<${Failure} error=${error} />`;
  if (!found) return null;
  const about = (note) =>
    note.number === 0
      ? "Description"
      : `Note ${note.number}, ${moment(note.at)}${(note.checkpoint ?? null) === null ? "" : `, at checkpoint ${note.checkpoint}`}${note.edited_at ? ", edited" : ""}`;
  return html`
    <ul class="model-notes">${found.notes.map(
      (note) => html`<li key=${note.number}>
      <p class="note-text">${note.text}</p>
      <p class="actions fine quiet">${about(note)}
        <${Button} class="fine" aria-label=${`Edit note ${note.number}`} onClick=${() => edit(note)}>Edit<//>
        <${Button} class="fine" aria-label=${`Remove note ${note.number}`} onClick=${() => drop(note)}>Remove<//>
      </p>
    </li>`,
    )}</ul>
    ${!found.notes.length && html`<${Empty} text="There is no note yet. Notes stay with the model, also in copies of it." />`}
    ${!found.notes.some((note) => note.number === 0) && html`<p><button type="button" onClick=${() => edit({ number: 0, text: "" })}>Describe the model</button></p>`}
    <${Form} onSubmit=${add}>
      <${DraftNote} draft=${draft} />
      <${Field} label="New note" rows=${3} maxlength="2000" value=${text} set=${(given) => draft.change("text", given, "")} />
      <p class="actions"><button type="submit" class="main" disabled=${!text.trim()}>Add the note</button></p>
    <//>`;
}
