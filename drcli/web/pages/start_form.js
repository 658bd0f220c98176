// Check everything, and start the training.

import { post } from "/api.js";
import { confirmed } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { Problems, TextField } from "/fields.js";
import { taskEnd } from "/model_tasks.js";
import { notify } from "/notices.js";
import { DraftNote } from "/steps.js";
import { useAction, useGet, useTopic } from "/store.js";
import { Button, Failure, html, useEffect, useState } from "/ui.js";

const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

export function ValidateStep({ number, saveAll, lead }) {
  const [compatible, setCompatible] = useState(false);
  const [found, setFound] = useState(null);
  const [error, setError] = useState(null);
  const [validate, busy] = useAction(async () => {
    if (!(await saveAll("validate"))) return;
    setError(null);
    try {
      setFound(await post("/api/validate", { console_compatible: compatible }));
    } catch (failure) {
      setFound(null);
      setError(failure);
    }
  });
  const state = busy
    ? "Checking settings, files, bucket and this machine ..."
    : error
      ? "Not checked."
      : found &&
        (found.ok
          ? `A training can start. ${plural(found.warnings.length, "warning")}.`
          : `A training cannot start: ${plural(found.errors.length, "error")}, ${plural(found.warnings.length, "warning")}.`);
  return html`
    <section class="step" id="step-validate" aria-labelledby="title-validate">
      <h2 id="title-validate" tabindex="-1">${number}. Validate</h2>
      <p class="quiet">Checks settings, your three files, the bucket and this machine. Nothing is changed.</p>
      <p class="actions"><label><input type="checkbox" checked=${compatible} onChange=${(event) => setCompatible(event.currentTarget.checked)} />
        ${" "}Also apply the limits of the DeepRacer console</label></p>
      <div class="actions"><${Button} busy=${busy} onClick=${validate}>Validate now<//><p class="step-state" role="status">${state}</p></div>
      ${error && html`<${Failure} error=${error} />`}
      ${
        found &&
        !busy &&
        html`<${Problems} problems=${[...found.errors, ...found.warnings, ...found.notes]} lead=${lead} />
        ${
          found.skipped.length > 0 &&
          html`<ul class="problems">${found.skipped.map(
            (each) =>
              html`<li><strong>Not checked</strong> ${each.rules.join(", ")}: ${each.reason}</li>`,
          )}</ul>`
        }`
      }
    </section>`;
}

/** What there is to say about the model before its start. */
function aboutModel(facts) {
  const texts = [`The model is called ${facts.model}.`];
  if (facts.pretrained) texts.push(`It begins with the weights of ${facts.pretrained}.`);
  if (facts.trains)
    texts.push(
      `Run ${facts.run_id} is training ${facts.trains} now. Stop it first, or choose another DR_RUN_ID in the settings.`,
    );
  else if (facts.checkpoint)
    texts.push(
      `The bucket has a model of this name, with checkpoint ${facts.checkpoint}. Resume this one, or give the new model another name in step 1.`,
    );
  else if (facts.used)
    texts.push(
      "The bucket has files under this name, but no checkpoint. Give the new model another name in step 1.",
    );
  if (facts.fetch.length) texts.push(`${facts.fetch.join(", ")} will be downloaded first.`);
  if (facts.bucket_error) texts.push(`The bucket cannot be read now: ${facts.bucket_error}`);
  return texts;
}

/** A number that a field has, null if it is empty; an error with a remedy for anything else. */
function numberOf(text, whole, noun, unit) {
  const word = text.trim();
  if (!word) return null;
  if (whole ? /^\d+$/.test(word) : /^\d+(\.\d+)?$/.test(word)) return Number(word);
  throw Object.assign(
    new Error(`${noun} ${word} is not a ${whole ? "whole number" : `number of ${unit}`}.`),
    {
      remedy: whole
        ? "Write digits only, or leave it empty."
        : "Write a number such as 8.5, or leave it empty.",
    },
  );
}

/** Whether the start is wanted: what it deletes, resumes or downloads is asked for; null if not. */
async function consent(how, facts) {
  if (how === "wipe") {
    const detail = "All its checkpoints, traces and videos in the bucket are lost.";
    if (
      !(await confirmed(`Delete the model ${facts.model} and start over?`, {
        action: "Delete and start",
        detail,
      }))
    )
      return null;
  }
  if (how === "resume") {
    const detail = `It goes on from checkpoint ${facts.checkpoint}.`;
    if (!(await confirmed(`Resume the training of ${facts.model}?`, { action: "Resume", detail })))
      return null;
  }
  if (!facts.fetch.length || facts.fetch_allowed !== "ask") return { fetch: false };
  const question = `Download the track ${facts.fetch.join(", ")} from the address DR_TRACKS_URL?`;
  const detail = "It is a track of the community that is not installed.";
  return (await confirmed(question, { action: "Download and start", detail }))
    ? { fetch: true }
    : null;
}

export function StartStep({ folder, number, saveAll, lead, changes }) {
  const { value: facts, error: broken, reload } = useGet("/api/start");
  const run = useTopic("run").value;
  const tasks = useTopic("tasks").value?.tasks ?? [];
  const draft = useDraft(`${folder}/start`, null);
  const wanted = draft.edits;
  const [mine, setMine] = useState(0);
  const [error, setError] = useState(null);
  useEffect(() => {
    if (facts) reload();
  }, [changes, run?.state === "running"]);
  const [start, busy] = useAction(async (how) => {
    setError(null);
    try {
      const asked = { seed: numberOf(wanted.seed ?? "", true, "Seed") };
      for (const { key, whole, noun, unit } of facts.goals)
        asked[key] = numberOf(wanted[key] ?? "", whole, noun, unit);
      if (!(await saveAll("start"))) return;
      const agreed = await consent(how, facts);
      if (!agreed) return;
      const { id } = await post("/api/start", { how, confirmed: facts.model, ...agreed, ...asked });
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
  });
  const task = tasks.find((each) => each.id === mine);
  const state = busy && mine ? task?.text || "Starting ..." : error ? "Not started." : "";
  const idle = facts && !facts.trains && !busy;
  const set = (key) => (text) => {
    const { [key]: _, ...others } = wanted;
    draft.set(text ? { ...others, [key]: text } : others);
  };
  return html`
    <section class="step" id="step-start" aria-labelledby="title-start">
      <h2 id="title-start" tabindex="-1">${number}. Start</h2>
      ${broken && html`<${Failure} error=${broken} />`}
      ${facts && aboutModel(facts).map((text) => html`<p>${text}</p>`)}
      <${DraftNote} draft=${draft} />
      <div class="fields narrow">
        ${(facts?.goals ?? []).map(
          (
            goal,
          ) => html`<${TextField} key=${goal.key} label=${goal.label} help=${goal.hint} numeric=${true}
          placeholder="no limit" value=${wanted[goal.key] ?? ""} onInput=${set(goal.key)} />`,
        )}
        <${TextField} label="Seed (this start only)" help="Repeats a training exactly. Empty: DR_TRAIN_SEED, or a new one." numeric=${true}
          placeholder="drawn" value=${wanted.seed ?? ""} onInput=${set("seed")} />
      </div>
      <div class="actions">
        <button type="button" class="main" disabled=${!idle || facts.used} onClick=${() => start("new")}>Start the training</button>
        ${facts?.checkpoint && html`<button type="button" disabled=${!idle} onClick=${() => start("resume")}>Resume this model</button>`}
        ${facts?.used && html`<button type="button" class="danger" disabled=${!idle} onClick=${() => start("wipe")}>Delete the model and start over</button>`}
        <p class="step-state" role="status">${state}</p>
      </div>
      ${error && (error.problems ? html`<${Problems} problems=${error.problems} lead=${lead} />` : html`<${Failure} error=${error} />`)}
    </section>`;
}
