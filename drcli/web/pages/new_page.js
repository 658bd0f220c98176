// New training: everything that a training needs, in order.

import { get, post } from "/api.js";
import { ActionStep, SensorStep, useMetadata } from "/action_space_form.js";
import { confirmed } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { Field, Problems, TextField, leadTo, wantedLine } from "/fields.js";
import { HyperparameterStep } from "/hyperparameter_form.js";
import { notify } from "/notices.js";
import { KIND_NOTES, OBJECT_SETTINGS } from "/race_words.js";
import { RewardStep } from "/reward_form.js";
import { StartStep, ValidateStep } from "/start_form.js";
import { Step, Steps, useSettings } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { TrackPicker } from "/track_picker.js";
import { Failure, Prose, html, useEffect, useMemo, useRef, useState } from "/ui.js";

export const title = "New training";

const ORDER = [
  "model",
  "race",
  "sensors",
  "hyperparameters",
  "actions",
  "reward",
  "stop",
  "validate",
  "start",
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

export function Page({ query }) {
  const folder = useGet("/api/new-folder");
  const [parts, setParts] = useState(null);
  const [error, setError] = useState(null);
  const exists = folder.value?.exists;
  const read = async () => {
    try {
      const answers = await Promise.all(Object.values(PATHS).map((path) => get(path)));
      setParts(Object.fromEntries(Object.keys(PATHS).map((name, k) => [name, answers[k]])));
      setError(null);
    } catch (failure) {
      setError(failure);
    }
  };
  useEffect(() => {
    if (exists) read();
  }, [exists]);
  const reload = async (name) => {
    const value = await get(PATHS[name]);
    setParts((before) => ({ ...before, [name]: value }));
  };
  if (folder.error) return html`<h1>${title}</h1><${Failure} error=${folder.error} />`;
  if (exists === false)
    return html`<h1>${title}</h1><${NewFolder} folder=${folder.value} made=${folder.reload} />`;
  if (error)
    return html`
    <h1>${title}</h1>
    <p>Correct the settings first; then this page goes on.</p>
    ${error.problems ? html`<${Problems} problems=${error.problems} lead=${toSettings} />` : html`<${Failure} error=${error} />`}
    <p class="actions"><a class="button main" href="#/settings">Open the settings</a><button type="button" onClick=${read}>Try again</button></p>`;
  if (!parts) return html`<h1>${title}</h1><p role="status">Reading the folder ...</p>`;
  return html`<${Form} parts=${parts} reload=${reload} query=${query} />`;
}

function toSettings(problem) {
  location.hash = problem.key?.startsWith("DR_") ? `#/settings?name=${problem.key}` : "#/settings";
}
const lead = (problem) => leadTo(problem) || toSettings(problem);

function Form({ parts, reload, query }) {
  const { form } = parts;
  const { steps: labels } = form;
  const steps = useRef(new Map());
  const versions = useRef(form.versions);
  const [dirty, setDirty] = useState({});
  const [changes, setChanges] = useState(0);
  const changed = () => setChanges((times) => times + 1);
  const announce = (id, step) => {
    steps.current.set(id, step);
    if (Boolean(dirty[id]) !== step.dirty) setDirty((before) => ({ ...before, [id]: step.dirty }));
  };
  const settings = (name) => ({
    ...{ form, versions, draftName: name, names: Object.keys(labels[name]) },
    saved: async () => {
      await reload("form");
      changed();
    },
  });
  const model = useSettings(settings("model"));
  const race = useSettings(settings("race"));
  const stop = useSettings(settings("stop"));
  const of = (name) => ({ reload: () => reload(name), folder: form.directory, saved: changed });
  const metadata = useMetadata({ facts: parts.metadata, ...of("metadata") });

  useEffect(() => {
    const wanted = query.get("step");
    if (query.get("line"))
      wantedLine.value = { line: Number(query.get("line")), times: wantedLine.value.times + 1 };
    else if (ORDER.includes(wanted))
      document.getElementById(`step-${wanted}`).scrollIntoView({ block: "start" });
  }, [query]);

  /** Save what is not saved, after a question; false if something is left. */
  const saveAll = async (what) => {
    const open = ORDER.map((id) => [id, steps.current.get(id)]).filter(([, step]) => step?.dirty);
    if (!open.length) return true;
    const names = open.map(([, step]) => step.title).join(", ");
    const detail = "The check and the training read the saved files.";
    if (
      !(await confirmed(`${names}: not saved yet. Save and ${what}?`, {
        action: "Save all",
        detail,
      }))
    )
      return false;
    for (const [id, step] of open)
      if (!(await step.save())) {
        document.getElementById(`step-${id}`).scrollIntoView({ block: "start" });
        return false;
      }
    return true;
  };
  const go = (id) => {
    document.getElementById(`step-${id}`).scrollIntoView({ block: "start" });
    document.getElementById(`title-${id}`).focus({ preventScroll: true });
  };
  const kind = race.value("DR_RACE_TYPE");
  const isOther = (name) =>
    Object.entries(OBJECT_SETTINGS).some(
      ([each, prefix]) => name.startsWith(prefix) && each !== kind,
    );
  const pretrained = model.value("DR_LOCAL_S3_PRETRAINED") === "True";
  const fields = (edits, step, hidden = (_name) => false) =>
    html`<div class="fields">${Object.entries(labels[step])
      .filter(([name]) => edits.facts.has(name))
      .map(([name, label]) => edits.field(name, { label, hidden: hidden(name) }))}</div>`;
  const frame = (id, heading, edits, hint, content) => html`
    <${Step} id=${id} title=${heading} hint=${hint} dirty=${edits.dirty} saving=${edits.saving} draft=${edits.draft} problems=${edits.problems}>${content}<//>`;
  const context = useMemo(() => ({ announce, numbers: NUMBERS }), [dirty]);
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
          ${frame(
            "model",
            "Model",
            model,
            "The name is the folder of the model in the bucket: letters, digits and . _ - /. Give each training a new name.",
            fields(
              model,
              "model",
              (name) => name.startsWith("DR_LOCAL_S3_PRETRAINED_") && !pretrained,
            ),
          )}
          ${frame(
            "race",
            "Track and race",
            race,
            "",
            html`
            <${TrackPicker} found=${parts.tracks} chosen=${race.value("DR_WORLD_NAME")} further=${race.value("DR_TRAIN_WORLDS")}
              onChoose=${(name) => race.set("DR_WORLD_NAME", name)} onFurther=${(words) => race.set("DR_TRAIN_WORLDS", words)} />
            ${fields(race, "race", isOther)}
            <p role="status">${KIND_NOTES[kind]}</p>`,
          )}
          <${SensorStep} metadata=${metadata} />
          <${HyperparameterStep} facts=${parts.hyperparameters} algorithm=${metadata.now.training_algorithm} ...${of("hyperparameters")} />
          <${ActionStep} metadata=${metadata} />
          <${RewardStep} facts=${parts.reward} known=${parts.templates} changes=${changes} ...${of("reward")} />
          ${frame(
            "stop",
            "Stop conditions",
            stop,
            "The training ends as soon as one of them is met; 0 or empty is no limit. It can be stopped by hand at any time, and resumed. A number of laps is asked for at the start, in step 9.",
            fields(stop, "stop"),
          )}
          <${ValidateStep} number=${NUMBERS.validate} saveAll=${saveAll} lead=${lead} />
          <${StartStep} folder=${form.directory} number=${NUMBERS.start} saveAll=${saveAll} lead=${lead} changes=${changes} />
        </div>
      <//>
    </div>`;
}

/** A folder without run.env: write the files of a new one, then go on. */
function NewFolder({ folder, made }) {
  const draft = useDraft(`${folder.directory}/new-folder`, null);
  const { name = "first-model", begin = "preset:" } = draft.edits;
  const [error, setError] = useState(null);
  const write = async (replace) => {
    const [kind, chosen] = begin.split(":");
    try {
      const values = { DR_LOCAL_S3_MODEL_PREFIX: name.trim() };
      const done = await post("/api/new-folder", { values, [kind]: chosen, replace });
      notify(
        `${done.written.length} files written to ${done.folder}.${done.model ? ` ${done.model} is the trained model.` : ""}`,
      );
      for (const warning of done.warnings) notify(warning, "warn");
      draft.set({});
      made();
    } catch (failure) {
      const detail = `${failure.message} The old files are kept as .bak.`;
      if (!failure.clashes || replace) setError(failure);
      else if (
        await confirmed(`Replace ${failure.clashes.join(", ")}?`, { action: "Replace", detail })
      )
        await write(true);
    }
  };
  const [create, busy] = useAction(() => write(false));
  const problems = (error?.problems ?? []).map((each) => ({ ...each, where: "" }));
  const options = (kind, list) =>
    list.map(
      (each) => html`<option value=${`${kind}:${each.name}`}>${each.name}: ${each.about}</option>`,
    );
  return html`
    <div class="empty">
      <p>${folder.directory} is not a working folder yet: it has no run.env.</p>
      <p><${Prose} text="Create one here. It gets run.env, system.env, your three files in custom_files/, and bin/activate.sh." /></p>
    </div>
    <form class="fields" onSubmit=${(event) => {
      event.preventDefault();
      create();
    }}>
      <${TextField} label="Name of the first model" value=${name} onInput=${(text) => draft.set({ ...draft.edits, name: text })} problems=${problems} help="Letters, digits and . _ - /. It can be changed in the next step." />
      <${Field} label="Begin with" control=${(
        common,
      ) => html`<select ...${common} value=${begin} onChange=${(event) => draft.set({ ...draft.edits, begin: event.currentTarget.value })}>
        <option value="preset:">The usual start: stay near the middle of the road</option>
        <optgroup label="Settings and files for a purpose">${options("preset", folder.presets)}</optgroup>
        <optgroup label="A trained model, to drive at once or to train on">${options("model", folder.models)}</optgroup>
      </select>`} />
      <div class="actions"><button type="submit" class="main" disabled=${busy}>Create the working folder</button></div>
    </form>
    ${error && !problems.length && html`<div role="status"><${Failure} error=${error} /></div>`}`;
}
