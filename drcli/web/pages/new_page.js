// New training: everything that a training needs, in order.

import { get, post } from "/api.js";
import { ActionStep, SensorStep, useMetadata } from "/action_space_form.js";
import { confirmed } from "/ask.js";
import { useDraft } from "/drafts.js";
import { Field, Refused, leadTo, wantedLine } from "/fields.js";
import { HyperparameterStep } from "/hyperparameter_form.js";
import { notify } from "/notices.js";
import { RewardStep } from "/reward_form.js";
import { StartStep, ValidateStep } from "/start_form.js";
import { Step, Steps, useSettings } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { TrackPicker } from "/track_picker.js";
import { Button, Failure, Form, html, useEffect, useMemo, useRef, useState } from "/ui.js";

export const title = "New training";

const ORDER = [
  ...["model", "race", "sensors", "hyperparameters", "actions", "reward"],
  ...["stop", "validate", "start"],
];
const NUMBERS = Object.fromEntries(ORDER.map((id, k) => [id, k + 1]));
const TITLES = { validate: "Validate", start: "Start" };
const PATHS = {
  form: "/api/settings",
  tracks: "/api/track-list",
  metadata: "/api/metadata",
  hyperparameters: "/api/hyperparameters",
  reward: "/api/reward",
  templates: "/api/reward/templates",
};

const show = (id) => document.getElementById(`step-${id}`).scrollIntoView({ block: "start" });
function toSettings(problem) {
  location.hash = problem.key?.startsWith("DR_") ? `#/settings?name=${problem.key}` : "#/settings";
}
const lead = (problem) => leadTo(problem) || toSettings(problem);

export function Page({ query }) {
  const folder = useGet("/api/new-folder");
  const [parts, setParts] = useState(null);
  const [error, setError] = useState(null);
  const exists = folder.value?.exists;
  const read = async (names = Object.keys(PATHS)) => {
    const answers = await Promise.all(names.map((name) => get(PATHS[name])));
    const found = Object.fromEntries(names.map((name, k) => [name, answers[k]]));
    setParts((before) => ({ ...before, ...found }));
  };
  const begin = () => read().then(() => setError(null), setError);
  useEffect(() => {
    if (exists) begin();
  }, [exists]);
  const heading = html`<h1>${title}</h1>`;
  if (folder.error) return html`${heading}<${Failure} error=${folder.error} />`;
  if (exists === false)
    return html`${heading}<${NewFolder} folder=${folder.value} made=${folder.reload} />`;
  if (error)
    return html`
      ${heading}
      <p>Correct the settings first; then this page goes on.</p>
      <${Refused} error=${error} lead=${toSettings} />
      <p class="actions"><a class="button main" href="#/settings">Open the settings</a><button type="button" onClick=${begin}>Try again</button></p>`;
  if (!parts) return html`${heading}<p role="status">Reading the folder ...</p>`;
  return html`<${Training} parts=${parts} reload=${(name) => read([name])} query=${query} />`;
}

function Training({ parts, reload, query }) {
  const { form } = parts;
  const steps = useRef(new Map());
  const versions = useRef(form.versions);
  const [dirty, setDirty] = useState({});
  const [changes, setChanges] = useState(0);
  const changed = () => setChanges((times) => times + 1);
  const announce = (id, step) => {
    steps.current.set(id, step);
    if (Boolean(dirty[id]) !== step.dirty) setDirty((before) => ({ ...before, [id]: step.dirty }));
  };
  const settings = (id) => {
    const names = form.steps[id].fields.map(({ name }) => name);
    const saved = async () => {
      await reload("form");
      changed();
    };
    return { id, form, edits: useSettings({ form, versions, draftName: id, names, saved }) };
  };
  const [model, race, stop] = ["model", "race", "stop"].map(settings);
  const { value, set } = race.edits;
  const of = (name) => ({ reload: () => reload(name), folder: form.directory, saved: changed });
  const metadata = useMetadata({ facts: parts.metadata, ...of("metadata") });

  useEffect(() => {
    const wanted = query.get("step");
    if (query.get("line"))
      wantedLine.value = { line: Number(query.get("line")), times: wantedLine.value.times + 1 };
    else if (ORDER.includes(wanted)) show(wanted);
  }, [query]);

  /** Save what is not saved, after a question; false if something is left. */
  const saveAll = async (what) => {
    const open = ORDER.map((id) => [id, steps.current.get(id)]).filter(([, step]) => step?.dirty);
    const names = open.map(([, step]) => step.title).join(", ");
    const question = `${names}: not saved yet. Save and ${what}?`;
    const detail = "The check and the training read the saved files.";
    if (open.length && !(await confirmed(question, { action: "Save all", detail }))) return false;
    for (const [id, step] of open)
      if (!(await step.save())) {
        show(id);
        return false;
      }
    return true;
  };
  const go = (id) => {
    show(id);
    document.getElementById(`title-${id}`).focus({ preventScroll: true });
  };
  const context = useMemo(() => ({ announce, numbers: NUMBERS }), [dirty]);
  const last = { saveAll, lead, changes };
  return html`
    <h1>${title}</h1>
    <p class="quiet">Folder ${form.directory}, settings in ${form.run_file}. Each step has its own Save; until then, what you change is kept in this browser only.</p>
    <div class="new-training">
      <nav class="steps" aria-label="Steps"><ol>${ORDER.map(
        (id) => html`<li key=${id}>
        <button type="button" class="link" onClick=${() => go(id)}>${steps.current.get(id)?.title ?? TITLES[id]}</button>
        ${dirty[id] && html`<span class="step-mark"> not saved</span>`}
      </li>`,
      )}</ol></nav>
      <${Steps.Provider} value=${context}>
        <div class="step-list">
          <${SettingsStep} ...${model} />
          <${SettingsStep} ...${race}>
            <${TrackPicker} found=${parts.tracks} chosen=${value("DR_WORLD_NAME")} further=${value("DR_TRAIN_WORLDS")}
              onChoose=${(name) => set("DR_WORLD_NAME", name)} onFurther=${(words) => set("DR_TRAIN_WORLDS", words)} />
            <p role="status">${form.kind_notes[value("DR_RACE_TYPE")]}</p>
          <//>
          <${SensorStep} metadata=${metadata} />
          <${HyperparameterStep} facts=${parts.hyperparameters} algorithm=${metadata.now.training_algorithm} ...${of("hyperparameters")} />
          <${ActionStep} metadata=${metadata} />
          <${RewardStep} facts=${parts.reward} known=${parts.templates} changes=${changes} ...${of("reward")} />
          <${SettingsStep} ...${stop} />
          <${ValidateStep} ...${last} />
          <${StartStep} folder=${form.directory} ...${last} />
        </div>
      <//>
    </div>`;
}

/** A step whose fields are settings; some have a meaning only with a value of another one. */
function SettingsStep({ id, form, edits, children = null }) {
  const { title: heading, hint, fields } = form.steps[id];
  const { dirty, saving, draft, problems } = edits;
  const isHidden = (only) => only && !only[1].includes(edits.value(only[0]));
  return html`
    <${Step} ...${{ id, title: heading, hint, dirty, saving, draft, problems }}>
      ${children}
      <div class="fields">${fields
        .filter(({ name }) => edits.facts.has(name))
        .map(({ name, label, only }) => edits.field(name, { label, hidden: isHidden(only) }))}</div>
    <//>`;
}

/** A folder without run.env: write the files of a new one, then go on. */
function NewFolder({ folder, made }) {
  const draft = useDraft(`${folder.directory}/new-folder`, null);
  const start = { name: "first-model", begin: "preset:" };
  const { name, begin } = { ...start, ...draft.edits };
  const set = (key) => (text) => draft.change(key, text, start[key]);
  const [error, setError] = useState(null);
  const [create, busy] = useAction(async (replace) => {
    const [kind, chosen] = begin.split(":");
    const values = { DR_LOCAL_S3_MODEL_PREFIX: name.trim() };
    const write = (again) =>
      post("/api/new-folder", { values, [kind]: chosen, replace: again }).catch(async (failure) => {
        if (!failure.clashes || again) throw failure;
        const question = `Replace ${failure.clashes.join(", ")}?`;
        const detail = `${failure.message} The old files are kept as .bak.`;
        return (await confirmed(question, { action: "Replace", detail })) && write(true);
      });
    const done = await write(false).catch(setError);
    if (!done) return;
    const model = done.model ? ` ${done.model} is the trained model.` : "";
    notify(`${done.written.length} files written to ${done.folder}.${model}`);
    for (const warning of done.warnings) notify(warning, "warn");
    draft.set({});
    made();
  });
  const problems = (error?.problems ?? []).map((each) => ({ ...each, where: "" }));
  return html`
    <div class="empty">
      <p>${folder.directory} is not a working folder yet: it has no run.env.</p>
      <p>Create one here. It gets <code>run.env</code>, <code>system.env</code>, your three files in <code>custom_files/</code>, and <code>bin/activate.sh</code>.</p>
    </div>
    <${Form} class="fields" onSubmit=${create}>
      <${Field} label="Name of the first model" value=${name} set=${set("name")} problems=${problems} help="Letters, digits and . _ - /. It can be changed in the next step." />
      <${Field} label="Begin with" value=${begin} set=${set("begin")} options=${folder.begin} />
      <div class="actions"><${Button} type="submit" class="main" busy=${busy}>Create the working folder<//></div>
    <//>
    ${error && !problems.length && html`<div role="status"><${Failure} error=${error} /></div>`}`;
}
