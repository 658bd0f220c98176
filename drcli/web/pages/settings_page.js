// run.env and system.env as forms by group.

import { get, put } from "/api.js";
import { useDraft } from "/drafts.js";
import { Field, Problems, leadTo } from "/fields.js";
import { notify } from "/notices.js";
import { DraftNote, useSettings } from "/steps.js";
import { useAction } from "/store.js";
import { Button, Failure, Form, Loaded, Tick, html, useEffect, useRef, useState } from "/ui.js";

export const title = "Settings";

const PATH = "/api/settings";

export function Page({ query }) {
  const [found, setFound] = useState({ value: null, error: null });
  const reload = () =>
    get(PATH).then(
      (value) => setFound({ value, error: null }),
      (error) => setFound({ value: null, error }),
    );
  useEffect(() => {
    reload();
  }, []);
  return html`
    <h1>${title}</h1>
    <${Loaded} found=${found} reading="Reading the settings ...">${(form) => html`<${Settings} form=${form} reload=${reload} wanted=${query.get("name")} />`}<//>`;
}

function Settings({ form, reload, wanted }) {
  const [search, setSearch] = useState("");
  const [onlySet, setOnlySet] = useState(false);
  const versions = useRef(form.versions);
  versions.current = form.versions;
  const names = form.groups.flatMap((group) => group.settings.map((each) => each.name));
  const edits = useSettings({ form, versions, draftName: "settings", names, saved: reload });
  const { draft, dirty, saving, found } = edits;
  useEffect(() => {
    if (wanted) leadTo({ key: wanted });
  }, [wanted]);
  const word = search.trim().toLowerCase();
  const filtered = Boolean(word) || onlySet;
  const fits = ({ name, meaning, secret, value, place, environment }) =>
    `${name} ${meaning} ${secret ? "" : value}`.toLowerCase().includes(word) &&
    (!onlySet || place || environment);
  const groups = form.groups.map((group) => ({ ...group, shown: group.settings.filter(fits) }));
  const count = groups.reduce((sum, group) => sum + group.shown.length, 0);
  const changed = Object.keys(draft.edits).length;
  const { error } = saving;
  const unsaved = `${changed} ${changed === 1 ? "setting is" : "settings are"} not saved yet. ${error ? saving.state : ""}`;
  const saved = saving.state && `${saving.state} A training that runs keeps its settings.`;
  const problems = error?.problems ?? (dirty ? found : [...new Set([...form.problems, ...found])]);
  const lines = form.problems.filter((each) => each.line && !each.key);
  return html`
    <p class="quiet">${form.run_file} and system.env in ${form.directory}. $NAME in a value stands for the value of another setting. Values of the environment win over the files, and ${form.run_file} wins over system.env. Comments in the files stay.</p>
    <${DraftNote} draft=${draft} />
    <div class="row settings-bar">
      <${Field} label="Search settings" type="search" placeholder="Name or word" value=${search} set=${setSearch} />
      <p class="actions"><${Tick} label="Only those that are set" on=${onlySet} set=${setOnlySet} /></p>
      <div class="actions">
        <${Button} class="main" busy=${saving.busy} disabled=${!changed} onClick=${saving.save}>Save<//>
        <button type="button" disabled=${!changed} onClick=${() => draft.set({})}>Undo all</button>
        <p class="step-state" role="status">${changed ? unsaved : saved || "Nothing is changed."}</p>
      </div>
    </div>
    <p class="readout" role="status">${filtered && `${count} settings`}</p>
    ${error && !error.problems && html`<${Failure} error=${error} />`}
    <${Problems} problems=${problems} lead=${leadTo} />
    ${lines.map((each) => html`<${WrongLine} key=${each.where} problem=${each} version=${form.versions[each.file]} folder=${form.directory} mended=${reload} />`)}
    ${groups.map((group) => html`<${Group} key=${group.title} ...${group} edits=${edits} filtered=${filtered} />`)}`;
}

/** A line of which nobody knows the setting: it is written again, or becomes a comment. */
function WrongLine({ problem: { file, line, where }, folder, version, mended }) {
  const draft = useDraft(`${folder}/${where}`, version);
  const { text = "" } = draft.edits;
  const [error, setError] = useState(null);
  const [write, busy] = useAction(async () => {
    try {
      await put(`${PATH}/line`, { file, line, text, version });
      draft.set({});
      notify(`${where} is written; the old file is kept as .bak.`);
      mended();
    } catch (failure) {
      setError(failure);
    }
  });
  const problems = error ? (error.problems ?? [{ ...error, message: error.message }]) : [];
  return html`
    <${Form} class="row" onSubmit=${write}>
      <${Field} label=${`Write ${where} again`} value=${text} set=${(typed) => draft.change("text", typed, "")} placeholder="NAME=value, # comment, or nothing" problems=${problems} />
      <${Button} type="submit" busy=${busy}>Replace the line<//>
    <//>`;
}

function Group({ title: name, settings, shown, edits, filtered }) {
  const [open, setOpen] = useState(false);
  const set = settings.filter((facts) => facts.place).length;
  return html`
    <details class="group" open=${filtered ? shown.length > 0 : open} hidden=${!shown.length} onToggle=${(event) => !filtered && setOpen(event.currentTarget.open)}>
      <summary><h2>${name}</h2><span class="quiet"> ${settings.length} ${settings.length === 1 ? "setting" : "settings"}, ${set} set</span></summary>
      <div class="fields">${settings.map((facts) => edits.field(facts.name, { places: true, hidden: !shown.includes(facts) }))}</div>
    </details>`;
}
