// Check everything, and start the training.

import { post } from "/api.js";
import { confirmed } from "/ask.js";
import { useDraft } from "/drafts.js";
import { Fields, Problems, Refused, readFields, startOf } from "/fields.js";
import { taskEnd } from "/model_tasks.js";
import { notify } from "/notices.js";
import { DraftNote, Frame } from "/steps.js";
import { useAction, useGet, useTopic } from "/store.js";
import { Button, Failure, Tick, html, useEffect, useState } from "/ui.js";

export function ValidateStep({ saveAll, lead }) {
  const [compatible, setCompatible] = useState(false);
  const [found, setFound] = useState(null);
  const [error, setError] = useState(null);
  const [validate, busy] = useAction(async () => {
    if (!(await saveAll("validate"))) return;
    setFound(null);
    setError(null);
    await post("/api/validate", { console_compatible: compatible }).then(setFound, setError);
  });
  const said = error ? "Not checked." : found?.said;
  return html`
    <${Frame} id="validate" title="Validate" hint="Checks settings, your three files, the bucket and this machine. Nothing is changed.">
      <p class="actions"><${Tick} label="Also apply the limits of the DeepRacer console" on=${compatible} set=${setCompatible} /></p>
      <div class="actions">
        <${Button} busy=${busy} onClick=${validate}>Validate now<//>
        <p class="step-state" role="status">${busy ? "Checking settings, files, bucket and this machine ..." : said}</p>
      </div>
      <${Refused} error=${error} lead=${lead} />
      ${
        found &&
        html`
        <${Problems} problems=${[...found.errors, ...found.warnings, ...found.notes]} lead=${lead} />
        <ul class="problems">${found.skipped.map(
          ({ rules, reason }) =>
            html`<li key=${rules}><strong>Not checked</strong> ${rules.join(", ")}: ${reason}</li>`,
        )}</ul>`
      }
    <//>`;
}

export function StartStep({ folder, saveAll, lead, changes }) {
  const { value: facts, error: broken, reload } = useGet("/api/start");
  const run = useTopic("run").value;
  const tasks = useTopic("tasks").value?.tasks ?? [];
  const draft = useDraft(`${folder}/start`, null);
  const [mine, setMine] = useState(0);
  const [error, setError] = useState(null);
  useEffect(() => {
    if (facts) reload();
  }, [changes, run?.state === "running"]);
  const fields = facts?.fields ?? [];
  const values = { ...startOf(fields), ...draft.edits };
  const { given, wrong } = readFields(fields, values);
  const [start, busy] = useAction(async (how) => {
    setError(null);
    try {
      if (wrong.length) return lead(wrong[0]);
      if (!(await saveAll("start"))) return false;
      for (const ask of [facts.asks[how], facts.asks.fetch].filter(Boolean))
        if (!(await confirmed(ask.question, ask))) return false;
      const wanted = { how, confirmed: facts.model, fetch: Boolean(facts.asks.fetch), ...given };
      const { id } = await post("/api/start", wanted);
      setMine(id);
      const result = await taskEnd(id);
      notify(`The training of ${result.model} runs. ${result.ends}`);
      for (const text of result.warnings) notify(text, "warn");
      draft.set({});
      location.hash = "#/";
    } catch (failure) {
      setError(failure);
      reload();
    } finally {
      setMine(0);
    }
    return true;
  });
  const task = tasks.find((each) => each.id === mine);
  const state = busy && mine ? task?.text || "Starting ..." : error && "Not started.";
  const isIdle = facts && !facts.trains && !busy;
  const button = (text, how, kind, disabled = false) => html`
    <button type="button" class=${kind} disabled=${!isIdle || disabled} onClick=${() => start(how)}>${text}</button>`;
  return html`
    <${Frame} id="start" title="Start">
      ${broken && html`<${Failure} error=${broken} />`}
      ${facts?.said.map((text) => html`<p key=${text}>${text}</p>`)}
      <${DraftNote} draft=${draft} />
      <div class="fields narrow">
        <${Fields} fields=${fields} values=${values} problems=${wrong} set=${(name, text) => draft.change(name, text, "")} />
      </div>
      <div class="actions">
        ${button("Start the training", "new", "main", facts?.used)}
        ${facts?.checkpoint && button("Resume this model", "resume", null)}
        ${facts?.used && button("Delete the model and start over", "wipe", "danger")}
        <p class="step-state" role="status">${state}</p>
      </div>
      <${Refused} error=${error} lead=${lead} />
    <//>`;
}
