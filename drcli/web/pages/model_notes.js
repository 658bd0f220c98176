// The notes of a model: read, write, edit, remove.

import { post, put, remove } from "/api.js";
import { confirmed, empty, fill, h, moment, notify } from "/dom.js";
import { ask, field } from "/form_dialog.js";

/** Show notes and a form for a new one; `found` is the answer of `path`, where they are changed too. */
export function drawNotes(element, found, path, signal) {
  const writing = document.activeElement?.name === "note" ? document.activeElement.value : "";
  const area = h("textarea", { name: "note", rows: "3", maxlength: "2000", value: writing });
  const send = async (action) => {
    try {
      drawNotes(element, await action(), path, signal);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
    }
  };
  const edit = async (note) => {
    const values = await ask({
      title: note.number === 0 ? "Describe the model" : `Edit note ${note.number}`,
      action: "Save",
      fields: [
        field("Text", h("textarea", { name: "text", rows: "5", value: note.text, required: true })),
      ],
    });
    if (values) send(() => put(path, { number: note.number, text: values.text }, signal));
  };
  const drop = async (note) => {
    if (await confirmed("Remove this note?", { action: "Remove", detail: note.text }))
      send(() => remove(`${path}&number=${note.number}`, signal));
  };
  fill(
    element,
    found.notes.length
      ? h(
          "ul",
          { class: "model-notes" },
          found.notes.map((note) =>
            h(
              "li",
              {},
              h("p", { class: "note-text" }, note.text),
              h(
                "p",
                { class: "actions fine quiet" },
                note.number === 0
                  ? "Description"
                  : `Note ${note.number}, ${moment(note.at)}${note.checkpoint == null ? "" : `, at checkpoint ${note.checkpoint}`}${note.edited_at ? ", edited" : ""}`,
                h(
                  "button",
                  {
                    type: "button",
                    class: "fine",
                    "aria-label": `Edit note ${note.number}`,
                    click: () => edit(note),
                  },
                  "Edit",
                ),
                h(
                  "button",
                  {
                    type: "button",
                    class: "fine",
                    "aria-label": `Remove note ${note.number}`,
                    click: () => drop(note),
                  },
                  "Remove",
                ),
              ),
            ),
          ),
        )
      : empty("There is no note yet. Notes stay with the model, also in copies of it."),
    found.notes.some((note) => note.number === 0)
      ? null
      : h(
          "p",
          {},
          h(
            "button",
            { type: "button", click: () => edit({ number: 0, text: "" }) },
            "Describe the model",
          ),
        ),
    h(
      "form",
      {
        submit: (event) => {
          event.preventDefault();
          const text = area.value;
          area.value = "";
          send(() => post(path, { text }, signal));
        },
      },
      field("New note", area),
      h("p", { class: "actions" }, h("button", { class: "main" }, "Add the note")),
    ),
  );
  if (writing) element.querySelector("[name=note]").focus();
}
