// What organisers and racers are asked before something is done with a race: submit, drive, open, save, delete, watch.

import { get, getBlob, post, remove } from "/api.js";
import { ask } from "/ask.js";
import { confirmed, dialog } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { SelectField, TextField } from "/fields.js";
import { save } from "/model_tasks.js";
import { notify } from "/notices.js";
import { aboutField, racePath, videoPath } from "/race_words.js";
import { DraftNote } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { bytes, number } from "/text.js";
import { Button, Failure, html, useState } from "/ui.js";

/** Ask which checkpoint of which model is submitted by whom. @returns {Promise<Object | null>} the answer of the server */
export async function submitted(id) {
  const [{ models }, usual] = await Promise.all([get("/api/races/models"), get("/api/races/form")]);
  if (!models.length) {
    notify("There is no model in this bucket yet.", "bad", "Train one, or import one.", {
      text: "Models",
      href: "#/models",
    });
    return null;
  }
  const prefixes = models.map((each) => each.prefix);
  const prefix = prefixes.includes(usual.model) ? usual.model : prefixes[0];
  const start = { racer: usual.racer, prefix, checkpoint: "best" };
  return dialog(
    (close) =>
      html`<${Submission} id=${id} start=${start} prefixes=${prefixes} folder=${usual.folder} close=${close} />`,
    { label: "submit-title" },
  );
}

function Submission({ id, start, prefixes, folder, close }) {
  const draft = useDraft(`submit:${id}:${folder}`, 1);
  const values = { ...start, ...draft.edits };
  const [refused, setRefused] = useState(null);
  const listed = useGet(`/api/model/checkpoints?prefix=${encodeURIComponent(values.prefix)}`);
  const [submit, busy] = useAction(async () => {
    try {
      const answer = await post(racePath(id, "submit"), values);
      draft.saved(values);
      close(answer);
    } catch (error) {
      setRefused(aboutField(error));
    }
  });
  const field = (key, label) => ({
    ...{ label, value: values[key], "data-key": key },
    problems: refused?.key === key ? [refused] : [],
  });
  const set = (key, more) => (value) => {
    setRefused(null);
    draft.set({ ...draft.edits, ...more, [key]: value });
  };
  const options = listed.value
    ? listed.value.options
    : [
        ["best", "the best"],
        ["last", "the newest"],
      ];
  return html`
    <form class="ask" onSubmit=${(event) => {
      event.preventDefault();
      submit();
    }}>
      <h2 id="submit-title">Submit a model</h2>
      <p>The race gets a copy: you can train on, or delete the model.</p>
      <${DraftNote} draft=${draft} />
      <${TextField} ...${field("racer", "Racer")} onInput=${set("racer")} help="Each racer has one place on the leaderboard." />
      <${SelectField} ...${field("prefix", "Model")} options=${prefixes} onChange=${set("prefix", { checkpoint: "best" })} />
      <${SelectField} ...${field("checkpoint", "Checkpoint")} options=${options} onChange=${set("checkpoint")}
        help="How each drove in the evaluations of its training." />
      ${listed.error && html`<${Failure} error=${aboutField(listed.error)} />`}
      ${refused && !refused.key && html`<${Failure} error=${refused} />`}
      <p class="actions">
        <${Button} onClick=${() => {
          draft.set({});
          close(null);
        }}>Cancel<//>
        <button type="submit" class="main" aria-disabled=${busy ? "true" : null}>Submit</button>
      </p>
    </form>`;
}

/** The values of a dialog that the server describes; null if it was left. */
const asked = async (id, about) => ask(await get(`${racePath(id, "question")}?about=${about}`));

/** @returns {Promise<Object | null>} what the server is asked for */
export async function howToDrive(id) {
  const values = await asked(id, "run");
  return values && { video: { yes: true, no: false }[values.video] ?? null };
}

/** @returns {Promise<Object | null>} what the server is asked for */
export async function untilWhen(id) {
  const values = await asked(id, "open");
  return values && { closes: values.closes ? new Date(values.closes).toISOString() : "" };
}

/** Let the browser keep a file of the race; errors are those of the server. */
export async function keep(id, path, name) {
  const url = URL.createObjectURL(await getBlob(`${racePath(id)}/${path}`));
  save({ url, name });
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}

export async function savePage(id) {
  const values = await asked(id, "page");
  if (values) await keep(id, `page.html${values.videos ? "?videos=1" : ""}`, `${id}.html`);
}

export async function showLog(id) {
  const { path, text } = await get(racePath(id, "log"));
  const content = (close) => html`
    <h2 id="log-title">Log of the queue</h2>
    ${
      text === null
        ? html`<p>This machine has not driven the queue of this race in the background yet.</p>`
        : html`<p class="quiet">The end of ${path}</p><pre class="race-log" tabindex="0">${text}</pre>`
    }
    <p class="actions"><button type="button" autofocus onClick=${close}>Close</button></p>`;
  await dialog(content, { label: "log-title", wide: true });
}

export async function erase(id, { rules: { name } }) {
  const planned = await remove(`${racePath(id)}?dry_run`);
  const detail = `${number(planned.objects)} objects (${bytes(planned.size_bytes)}): its submissions, laps and videos. The models of the racers stay. It cannot be undone.`;
  if (!(await confirmed(`Delete the race ${name}?`, { action: "Delete this race", detail })))
    return;
  await remove(racePath(id));
  notify(`The race ${name} was deleted.`);
  location.hash = "#/races";
}

function Film({ id, video, name, close }) {
  const [broken, setBroken] = useState(false);
  return html`
    <h2 id="film-title">${name}</h2>
    <video controls autoplay muted playsinline src=${videoPath(id, video)} aria-label=${`Video: ${name}`} onError=${() => setBroken(true)}></video>
    ${broken && html`<p class="problem">This video cannot be played here. Save it, and open it with another player.</p>`}
    <p class="actions">
      <button type="button" autofocus onClick=${close}>Close</button>
      <a class="button" href=${videoPath(id, video, true)} download="">Save the video</a>
    </p>`;
}

export const watch = (id, video, name) =>
  dialog((close) => html`<${Film} id=${id} video=${video} name=${name} close=${close} />`, {
    label: "film-title",
    wide: true,
  });
