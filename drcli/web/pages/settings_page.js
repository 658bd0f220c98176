// run.env and system.env as forms by group.

import { useDraft } from "/drafts.js";
import { notify } from "/notices.js";
import { Problems, TextField, leadTo } from "/fields.js";
import { DraftNote, useSettings } from "/steps.js";
import { useAction } from "/store.js";
import { get, put } from "/api.js";
import { Button, Failure, html, useEffect, useRef, useState } from "/ui.js";

export const title = "Settings";

const PATH = "/api/settings";

export function Page({ query }) {
  const [form, setForm] = useState(null);
  const [error, setError] = useState(null);
  const reload = () => get(PATH).then(setForm, setError);
  useEffect(() => {
    reload();
  }, []);
  if (error) return html`<h1>${title}</h1><${Failure} error=${error} />`;
  if (!form) return html`<h1>${title}</h1><p role="status">Reading the settings ...</p>`;
  return html`<${Form} form=${form} reload=${reload} query=${query} />`;
}

function Form({ form, reload, query }) {
  const [search, setSearch] = useState("");
  const [onlySet, setOnlySet] = useState(false);
  const versions = useRef(form.versions);
  versions.current = form.versions;
  const names = form.groups.flatMap((group) => group.settings.map((each) => each.name));
  const edits = useSettings({ form, versions, draftName: "settings", names, saved: reload });
  const wanted = query.get("name");
  useEffect(() => {
    if (wanted) leadTo({ key: wanted });
  }, [wanted]);
  const word = search.trim().toLowerCase();
  const filtered = Boolean(word) || onlySet;
  const fits = (facts) =>
    `${facts.name} ${facts.meaning} ${facts.secret ? "" : facts.value}`
      .toLowerCase()
      .includes(word) &&
    (!onlySet || facts.place || facts.environment);
  const groups = form.groups.map(({ title: name, settings }) => ({
    name,
    settings,
    shown: settings.filter(fits),
  }));
  const count = groups.reduce((sum, group) => sum + group.shown.length, 0);
  const changed = Object.keys(edits.draft.edits).length;
  const state = changed
    ? `${changed} ${changed === 1 ? "setting is" : "settings are"} not saved yet. ${edits.saving.error ? edits.saving.state : ""}`
    : edits.saving.state
      ? `${edits.saving.state} A training that runs keeps its settings.`
      : "Nothing is changed.";
  const { error } = edits.saving;
  const problems =
    error?.problems ?? (edits.dirty ? edits.found : [...form.problems, ...edits.found]);
  return html`
    <h1>${title}</h1>
    <p class="quiet">${form.run_file} and system.env in ${form.directory}. $NAME in a value stands for the value of another setting. Values of the environment win over the files, and ${form.run_file} wins over system.env. Comments in the files stay.</p>
    <${DraftNote} draft=${edits.draft} />
    <div class="row settings-bar">
      <div class="field">
        <label for="settings-search">Search settings</label>
        <input type="search" id="settings-search" placeholder="Name or word" autocomplete="off" value=${search} onInput=${(event) => setSearch(event.currentTarget.value)} />
      </div>
      <p class="actions"><label><input type="checkbox" checked=${onlySet} onChange=${(event) => setOnlySet(event.currentTarget.checked)} /> Only those that are set</label></p>
      <div class="actions">
        <${Button} class="main" busy=${edits.saving.busy} disabled=${!changed} onClick=${edits.saving.save}>Save<//>
        <button type="button" disabled=${!changed} onClick=${() => edits.draft.set({})}>Undo all</button>
        <p class="step-state" role="status">${state}</p>
      </div>
    </div>
    <p class="readout" role="status">${filtered && `${count} settings`}</p>
    ${error && !error.problems && html`<${Failure} error=${error} />`}
    <${Problems} problems=${problems} lead=${leadTo} />
    ${form.problems
      .filter((each) => each.line && !each.key)
      .map(
        (each) => html`<${WrongLine} key=${each.where} problem=${each}
      folder=${form.directory} version=${form.versions[each.file]} mended=${reload} />`,
      )}
    ${groups.map((group) => html`<${Group} key=${group.name} ...${group} edits=${edits} filtered=${filtered} />`)}`;
}

/** A line of which nobody knows the setting: it is written again, or becomes a comment. */
function WrongLine({ problem, folder, version, mended }) {
  const { file, line, where } = problem;
  const draft = useDraft(`${folder}/${where}`, version);
  const { text = "" } = draft.edits;
  const [error, setError] = useState(null);
  const [write, busy] = useAction(async (written) => {
    try {
      await put(`${PATH}/line`, { file, line, text: written, version });
      draft.set({});
      notify(`${where} is written; the old file is kept as .bak.`);
      mended();
    } catch (failure) {
      setError(failure);
    }
  });
  return html`
    <form class="row" onSubmit=${(event) => {
      event.preventDefault();
      write(text);
    }}>
      <${TextField} label=${`Write ${where} again`} value=${text} onInput=${(typed) => draft.set(typed ? { text: typed } : {})} placeholder="NAME=value, # comment, or nothing"
        problems=${error ? (error.problems ?? [{ severity: "error", message: error.message, remedy: error.remedy }]) : []} />
      <button type="submit" aria-disabled=${busy ? "true" : null}>Replace the line</button>
    </form>`;
}

function Group({ name, settings, shown, edits, filtered }) {
  const [open, setOpen] = useState(false);
  const set = settings.filter((facts) => facts.place).length;
  return html`
    <details class="group" open=${filtered ? shown.length > 0 : open} hidden=${!shown.length} onToggle=${(event) => !filtered && setOpen(event.currentTarget.open)}>
      <summary><h2>${name}</h2><span class="quiet"> ${settings.length} ${settings.length === 1 ? "setting" : "settings"}, ${set} set</span></summary>
      <div class="fields">${settings.map((facts) => edits.field(facts.name, { places: true, hidden: !shown.includes(facts) }))}</div>
    </details>`;
}
