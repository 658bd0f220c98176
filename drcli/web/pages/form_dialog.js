// A dialog with fields and one action: native controls, so keyboard and screen reader know them.

import { fill, h } from "/dom.js";

let number = 0;

/** A labelled control; `hint` is a quiet line below it. */
export function field(label, control, hint = "") {
  const id = `field-${(number += 1)}`;
  control.id = id;
  if (hint) control.setAttribute("aria-describedby", `${id}-hint`);
  return h(
    "div",
    { class: "form-field" },
    h("label", { for: id }, label),
    control,
    hint ? h("p", { class: "quiet fine", id: `${id}-hint` }, hint) : null,
  );
}

/** A labelled check box. */
export function check(label, name, checked = false) {
  return h(
    "label",
    { class: "form-check" },
    h("input", { type: "checkbox", name, checked }),
    ` ${label}`,
  );
}

/** A selection; options are texts or [value, text]. */
export function select(name, options, chosen) {
  return h(
    "select",
    { name },
    options.map((each) => {
      const [value, text] = Array.isArray(each) ? each : [each, each];
      return h("option", { value, selected: String(value) === String(chosen) }, text);
    }),
  );
}

/**
 * Show a form in a dialog.
 * @param {{title: string, intro?: *, fields: *[], action: string, danger?: boolean, ready?: function(FormData): boolean}} spec
 * @returns {Promise<Object|null>} its values by name; check boxes are true or false; null if it was left.
 */
export function ask({ title, intro = null, fields, action, danger = false, ready = null }) {
  return new Promise((resolve) => {
    const button = h(
      "button",
      { value: "yes", class: danger ? "danger" : "main", disabled: ready !== null },
      action,
    );
    const form = h(
      "form",
      { method: "dialog", class: "ask" },
      h("h2", { id: "dialog-title" }, title),
      intro,
      fields,
      h(
        "p",
        { class: "actions" },
        h("button", { type: "button", click: () => dialog.close("") }, "Cancel"),
        button,
      ),
    );
    const dialog = h("dialog", { "aria-labelledby": "dialog-title" }, form);
    if (ready)
      form.addEventListener("input", () => {
        button.disabled = !ready(new FormData(form));
      });
    dialog.addEventListener("close", () => {
      const values = Object.fromEntries(new FormData(form));
      for (const box of form.querySelectorAll("input[type=checkbox]"))
        values[box.name] = box.checked;
      resolve(dialog.returnValue === "yes" ? values : null);
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** Tabs by the pattern of the ARIA guide: arrow keys move, the panel is shown at once. */
export function tabs(label, entries, first, onChange) {
  const panel = h("div", { role: "tabpanel", tabindex: "0", id: "panel", class: "part-panel" });
  const buttons = entries.map(([key, text]) =>
    h(
      "button",
      {
        type: "button",
        role: "tab",
        id: `tab-${key}`,
        "aria-controls": "panel",
        class: "part-tab",
        click: () => show(key),
        keydown: (event) => {
          const step = { ArrowRight: 1, ArrowLeft: -1, Home: -Infinity, End: Infinity }[event.key];
          if (step === undefined) return;
          event.preventDefault();
          const at = entries.findIndex(([each]) => each === key),
            last = entries.length - 1;
          const next =
            step === -Infinity
              ? 0
              : step === Infinity
                ? last
                : (at + step + entries.length) % entries.length;
          show(entries[next][0]);
          buttons[next].focus();
        },
      },
      text,
    ),
  );
  function show(key) {
    const at = Math.max(
      0,
      entries.findIndex(([each]) => each === key),
    );
    buttons.forEach((button, k) => {
      button.setAttribute("aria-selected", String(k === at));
      button.tabIndex = k === at ? 0 : -1;
    });
    panel.setAttribute("aria-labelledby", `tab-${entries[at][0]}`);
    fill(panel, entries[at][2]);
    if (buttons[at].isConnected)
      buttons[at].scrollIntoView({ block: "nearest", inline: "nearest" });
    onChange(entries[at][0]);
  }
  const element = h(
    "div",
    {},
    h("div", { role: "tablist", "aria-label": label, class: "part-tabs" }, buttons),
    panel,
  );
  return { element, show, start: () => show(first) };
}
