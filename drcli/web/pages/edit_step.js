// A step of "New training": a part of the page that is checked while it is edited and saved by itself.

import { post, put } from "/api.js";
import { confirmed, failure, fill, h, notify, prose } from "/dom.js";
import { chooseVersion, debounced, problemList, settingField } from "/setting_fields.js";

/**
 * The frame of a step.
 * @param {{id: string, title: string, hint?: string, save: function(): Promise<void>}} spec save throws what went wrong
 */
export function editStep({ id, title, hint = "", save }, ...content) {
  const state = h("p", { class: "step-state", role: "status" }, " ");
  const problems = h("div", { class: "step-problems" });
  const button = h(
    "button",
    { type: "button", class: "main", disabled: true, click: () => step.save() },
    "Save",
  );
  const step = {
    id,
    title,
    dirty: false,
    onChange: () => {},
    element: h(
      "section",
      { class: "step", id: `step-${id}`, "aria-labelledby": `title-${id}` },
      h("h2", { id: `title-${id}`, tabindex: "-1" }, title),
      hint ? h("p", { class: "quiet" }, prose(hint)) : null,
      h("div", { class: "step-broken" }),
      content,
      problems,
      h("div", { class: "actions" }, button, state),
    ),
    /** Whether something is not saved yet. */
    mark(dirty, text = null) {
      step.dirty = dirty;
      button.disabled = !dirty;
      if (text !== null) state.textContent = text;
      else if (dirty) state.textContent = "Not saved yet.";
      step.onChange();
    },
    say(text) {
      state.textContent = text;
    },
    problems(found, lead = null) {
      fill(problems, problemList(found, lead));
    },
    failed(error) {
      fill(problems, error.problems?.length ? problemList(error.problems) : failure(error));
    },
    /** Save; resolves to whether nothing is left to save. */
    async save() {
      if (!step.dirty) return true;
      button.disabled = true;
      state.textContent = "Saving ...";
      try {
        await save();
        return !step.dirty;
      } catch (error) {
        step.failed(error);
        step.mark(true, "Not saved; see above.");
        return false;
      }
    },
  };
  return step;
}

/**
 * A step made of settings.
 * @param {{id: string, title: string, hint?: string, store: Object, names: string[][], head?: Node[], foot?: Node[], saved?: function(): void, changed?: function(): void}} spec names: setting and label
 */
export function settingsStep(
  { id, title, hint, store, names, head = [], foot = [], saved = () => {}, changed = () => {} },
  signal,
) {
  const fields = new Map();
  const later = debounced(check, 500, signal);
  const change = () => {
    step.mark(wanted().length > 0, wanted().length ? null : "");
    changed();
    later();
  };
  for (const [name, label] of names) {
    const facts = store.settings.get(name);
    if (facts) fields.set(name, settingField(facts, { label, change }));
  }
  const wanted = () => [...fields.values()].filter((each) => each.changed);
  const step = editStep(
    { id, title, hint, save: () => write(store.versions) },
    head,
    h(
      "div",
      { class: "fields" },
      [...fields.values()].map((each) => each.element),
    ),
    foot,
  );
  step.fields = fields;

  function show(found) {
    for (const field of fields.values())
      field.problem(found.filter((each) => each.key === field.name));
    step.problems(found.filter((each) => !fields.has(each.key)));
  }
  async function check() {
    const values = Object.fromEntries(wanted().map((each) => [each.name, each.value]));
    if (!Object.keys(values).length) {
      show([]);
      return;
    }
    try {
      const checked = await post("/api/settings/check", { values }, signal);
      show([
        ...checked.problems.map((each) => ({ ...each, where: "" })),
        ...asWarnings(checked.warnings),
      ]);
    } catch (error) {
      if (error.name !== "AbortError") step.failed(error);
    }
  }
  async function write(versions) {
    const changes = wanted(),
      values = Object.fromEntries(changes.map((each) => [each.name, each.value]));
    const edit = await writeSettings(values, versions, signal);
    if (!edit) {
      step.mark(true, "Not saved.");
      return;
    }
    store.versions = edit.versions;
    for (const field of changes) field.saved({ written: edit.disk?.[field.name] ?? field.value });
    step.problems(asWarnings(edit.warnings));
    const files = [...new Set((edit.changes ?? []).map((each) => each.file))].join(" and ");
    step.mark(
      false,
      edit.disk ? "Taken from the disk." : `Saved in ${files}; the old file is kept as .bak.`,
    );
    saved();
  }
  step.lead = (problem) => {
    const field = fields.get(problem.key);
    field?.focus();
    return Boolean(field);
  };
  return step;
}

/** Sentences as problems. */
export const asWarnings = (sentences = []) =>
  sentences.map((message) => ({ severity: "warning", message, remedy: "", where: "", key: "" }));

/** Write settings, and ask where a file has changed on the disk; null where nothing was written. */
export async function writeSettings(values, versions, signal) {
  try {
    return await put("/api/settings", { values, versions }, signal);
  } catch (error) {
    if (error.status !== 409 || !error.answer?.conflict) throw error;
    const { conflict, versions: now } = error.answer;
    const choice = await chooseVersion(error.message, conflict);
    if (choice === "mine") return writeSettings(values, now, signal);
    if (choice === "disk")
      return {
        versions: now,
        changes: [],
        warnings: [],
        disk: Object.fromEntries(conflict.map((each) => [each.name, each.disk ?? ""])),
      };
    return null;
  }
}

/**
 * Save one of the three files; asks where it has changed on the disk.
 * @returns {Promise<Object|null>} the answer; `{disk: facts}` if the one on the disk is to be taken; null for neither
 */
export async function writeOwnFile(path, body, { mine, read, signal }) {
  try {
    return await put(path, body, signal);
  } catch (error) {
    if (error.status !== 409) throw error;
    const disk = await read();
    const choice = await chooseVersion(error.message, [
      { name: disk.file, yours: mine, disk: disk.text ?? JSON.stringify(disk.values, null, 2) },
    ]);
    if (choice === "mine")
      return writeOwnFile(path, { ...body, version: disk.version }, { mine, read, signal });
    return choice === "disk" ? { disk } : null;
  }
}

/** A file that is no JSON object can only be begun again. */
export function brokenFile(step, facts, path, again, signal) {
  const begin = async () => {
    try {
      notify(
        savedText(await put(path, { values: {}, version: facts.version, shipped: true }, signal)),
      );
      again();
    } catch (error) {
      if (error.name !== "AbortError") step.failed(error);
    }
  };
  fill(
    step.element.querySelector(".step-broken"),
    facts.broken
      ? h(
          "p",
          { class: "actions" },
          `${facts.file} cannot be read. Correct it with an editor, or `,
          h("button", { type: "button", click: begin }, "begin again with the shipped file"),
        )
      : null,
  );
}

/** What a page says after a file was saved. */
export function savedText(answer) {
  if (answer.others?.length)
    notify(
      `${answer.others.join(" and ")} ${answer.others.length > 1 ? "were" : "was"} written too: a training takes the shipped files only if there is none of your own.`,
    );
  return answer.changed
    ? `Saved in ${answer.file}${answer.backup ? `; the old one is kept as ${answer.backup}` : ""}.`
    : `${answer.file} was like this already.`;
}

/** Ask before a link leads away from what is not saved; the browser asks when its window is closed. */
export function guardLeaving(unsaved, signal) {
  addEventListener(
    "beforeunload",
    (event) => {
      if (unsaved()) event.preventDefault();
    },
    { signal },
  );
  document.addEventListener(
    "click",
    async (event) => {
      const link = event.target.closest?.("a[href^='#/']");
      if (
        !link ||
        link.getAttribute("href") === location.hash.split("?")[0] ||
        !unsaved() ||
        event.ctrlKey ||
        event.metaKey
      )
        return;
      event.preventDefault();
      if (await confirmed("Leave this page? What is not saved is lost.", { action: "Leave" }))
        location.hash = link.getAttribute("href");
    },
    { signal, capture: true },
  );
}
