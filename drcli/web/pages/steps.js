// Steps of "New training": parts of the page that are checked while they are edited, each with its own Save.

import { get, put } from "/api.js";
import { useDraft } from "/drafts.js";
import { Problems, Refused, SettingField, asWarnings, leadTo, useChecked } from "/fields.js";
import { savedText, writeOwnFile, writeSettings } from "/saving.js";
import { useAction } from "/store.js";
import { Button, Prose, createContext, html, useContext, useEffect, useState } from "/ui.js";

/** Where steps announce themselves: to the list of steps, and to the start, which saves them all. */
export const Steps = createContext({
  announce: (_id, _step) => {},
  numbers: /** @type {any} */ ({}),
});

const time = (at) =>
  new Date(at).toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" });

/** Says that unsaved changes are shown again, or that there are some of another tab. */
export function DraftNote({ draft }) {
  const { restored, found, set } = draft;
  return html`
    ${
      restored &&
      html`<p class="draft-note" role="status">
      What was changed at ${time(restored)} and not saved is shown again.
      <button type="button" class="link" onClick=${() => set({})}>Discard it</button>
    </p>`
    }
    ${
      found &&
      html`<p class="draft-note" role="status">
      There are changes of ${time(found.at)} from another tab that were not saved.
      <button type="button" class="link" onClick=${found.take}>Show them</button>
      <button type="button" class="link" onClick=${found.drop}>Discard them</button>
    </p>`
    }`;
}

/**
 * Saving of a step: its state in words, what went wrong, and the action.
 * @param {boolean} dirty whether something is not saved
 * @param {() => Promise<string | null>} write what is said then; null where nothing was written
 */
function useSaving(dirty, write) {
  const [said, setSaid] = useState({ text: "", isSaved: true });
  const [error, setError] = useState(null);
  const [save, busy] = useAction(async () => {
    try {
      const text = await write();
      setError(null);
      setSaid({ text: text ?? "Not saved.", isSaved: text !== null });
      return text !== null;
    } catch (failure) {
      setError(failure);
      setSaid({ text: "Not saved; see above.", isSaved: false });
      return false;
    }
  });
  useEffect(() => {
    if (dirty && !busy) setSaid({ text: "", isSaved: true });
  }, [dirty]);
  // What was changed while it was saved is not saved either.
  const unsaved = dirty && said.isSaved && "Not saved yet: it is kept in this browser.";
  const state = busy ? "Saving ..." : unsaved || said.text;
  return { save, busy, state, error: dirty ? error : null };
}

/**
 * Saving of edits of one of the three files.
 * @param {boolean} dirty whether there are any
 * @param {{path: string, draft: Object, edits: Record<string, any>, body: Object, mine: string, reload: () => Promise<void>,
 *   saved: () => void}} options `edits`: those of the draft that `body` has; `mine`: the text as it would become
 */
export function useFileSaving(dirty, { path, draft, edits, body, mine, reload, saved }) {
  return useSaving(dirty, async () => {
    const changed = { ...body, version: draft.version };
    const done = await writeOwnFile(path, changed, { mine, read: () => get(path) });
    if (!done) return null;
    await reload();
    draft.saved(edits, done.facts.version);
    saved();
    return done.text;
  });
}

/** The frame of a step. @param {{id: string, title: string, hint?: string, children?: any}} props */
export function Frame({ id, title, hint = "", children }) {
  const { numbers } = useContext(Steps);
  return html`
    <section class="step" id=${`step-${id}`} aria-labelledby=${`title-${id}`}>
      <h2 id=${`title-${id}`} tabindex="-1">${numbers?.[id] && `${numbers[id]}. `}${title}</h2>
      ${hint && html`<p class="quiet"><${Prose} text=${hint} /></p>`}
      ${children}
    </section>`;
}

/**
 * A step that is saved by itself.
 * @param {{id: string, title: string, hint?: string, dirty: boolean, saving: Object, draft?: Object, problems?: Object[], children?: any}} props
 */
export function Step({ id, title, hint = "", dirty, saving, ...more }) {
  const { draft = null, problems = [], children } = more;
  const { announce } = useContext(Steps);
  useEffect(() => announce(id, { title, dirty, save: saving.save }));
  const { error } = saving;
  return html`
    <${Frame} ...${{ id, title, hint }}>
      ${draft && html`<${DraftNote} draft=${draft} />`}
      ${children}
      <div class="step-problems">
        ${!error?.problems && html`<${Problems} problems=${problems} lead=${leadTo} />`}
        <${Refused} error=${error} />
      </div>
      <div class="actions">
        <${Button} class="main" busy=${saving.busy} disabled=${!dirty} onClick=${saving.save}>Save<//>
        <p class="step-state" role="status">${saving.state}</p>
      </div>
    <//>`;
}

/**
 * Edits of settings that are checked while they are made.
 * @param {{form: Object, draftName: string, names: string[], versions: {current: Object}, saved: () => void}} options
 *   `form` is the answer of /api/settings; `saved` is called when the files have changed
 */
export function useSettings({ form, draftName, names, versions, saved }) {
  const all = new Map(
    form.groups.flatMap((group) => group.settings).map((each) => [each.name, each]),
  );
  const facts = new Map(names.filter((name) => all.has(name)).map((name) => [name, all.get(name)]));
  const secrets = [...facts.values()].filter((each) => each.secret).map((each) => each.name);
  const draft = useDraft(`${form.directory}/${draftName}`, versions.current, secrets);
  const { edits } = draft;
  const dirty = Object.keys(edits).length > 0;
  const checked = useChecked("/api/settings/check", dirty ? { values: edits } : null);
  const [warnings, setWarnings] = useState([]);
  const saving = useSaving(dirty, async () => {
    // Edits that were left earlier were made to the files of that time.
    const edit = await writeSettings(edits, draft.restored ? draft.version : versions.current);
    if (!edit) return null;
    versions.current = edit.versions;
    setWarnings(edit.warnings);
    await saved();
    draft.saved(edits, edit.versions);
    return edit.text;
  });
  const found = dirty
    ? [...(checked.answer?.problems ?? []), ...asWarnings(checked.answer?.warnings)]
    : [...form.problems.filter((each) => facts.has(each.key)), ...asWarnings(warnings)];
  const value = (name) => edits[name] ?? facts.get(name).start;
  const set = (name, text) => draft.change(name, text, facts.get(name).start);
  const field = (name, props = {}) => {
    const own = { facts: facts.get(name), value: value(name), set: (text) => set(name, text) };
    return html`<${SettingField} key=${name} ...${own} ...${props}
      problems=${found.filter((each) => each.key === name).map((each) => ({ ...each, where: "" }))} />`;
  };
  const problems = found.filter((each) => !facts.has(each.key));
  const checkFailed = checked.error && { ...saving, error: saving.error ?? checked.error };
  return { draft, dirty, facts, field, found, problems, saving: checkFailed || saving, set, value };
}

/** A file that is no JSON object can only be begun again. */
export function BrokenFile({ facts, path, again }) {
  const [begin, busy] = useAction(async () => {
    savedText(await put(path, { values: {}, version: facts.version, shipped: true }));
    await again();
  });
  return (
    facts.broken &&
    html`<p class="actions">${facts.file} cannot be read. Correct it with an editor, or
      <${Button} busy=${busy} onClick=${begin}>begin again with the shipped file<//></p>`
  );
}
