// One model: numbers, reward graph, checkpoints, evaluations, files, notes, and what can be done with it.

import { modelActions, stopEvaluation } from "/model_actions.js";
import { Checkpoints } from "/model_checkpoints.js";
import { Evaluations } from "/model_evaluations.js";
import { Files } from "/model_files.js";
import { Notes } from "/model_notes.js";
import { Overview } from "/model_overview.js";
import { Badges, modelLink } from "/models_page.js";
import { Act, setQuery, useGet, useTopic } from "/store.js";
import { Failure, Tabs, Tiles, html, useTitle } from "/ui.js";

export const title = "Model";

export function Page({ query }) {
  const prefix = query.get("prefix") ?? "";
  return html`<${Model} key=${prefix} prefix=${prefix} query=${query} />`;
}

function Model({ prefix, query }) {
  const path = (name = "") =>
    `/api/model${name && `/${name}`}?prefix=${encodeURIComponent(prefix)}`;
  const { value: now, error: broken } = useTopic(`model:${prefix}`);
  const listed = useTopic("models").value?.models ?? [];
  const names = listed.map((each) => each.model.prefix);
  const own = JSON.stringify(listed.find((each) => each.model.prefix === prefix));
  const part = (name) => now && JSON.stringify(now.parts[name]);
  const running = now?.evaluations ?? [];
  const parts = ["checkpoints", "curve", "evaluations", "notes"].map(part);
  const { value: about, error: missing } = useGet(
    path(),
    now && [...parts, now.training, now.current, running.length, broken?.message, own].join(),
  );
  const checkpoints = useGet(path("checkpoints"), part("checkpoints"));
  useTitle(`${prefix} – DeepRacer console`);
  const all = html`<p class="fine"><a href="#/models">All models</a></p>`;
  const heading = html`${all}<h1>${prefix || "No model"}</h1>`;
  const error = broken ?? missing;
  if (error) return html`${heading}<${Failure} error=${error} />`;
  if (now && !now.exists)
    return html`${heading}<div class="problem"><p>This model was deleted.</p></div>`;
  if (!about) return html`${heading}<p role="status">Reading the model ...</p>`;
  const action = modelActions(prefix);
  const props = { prefix, path, action, names, running, checkpoints, other: query.get("other") };
  const tab = (key, name, Content, version) =>
    /** @type {[string, string, () => any]} */ ([
      key,
      name,
      () => html`<${Content} ...${props} version=${part(version)} />`,
    ]);
  const tabs = [
    tab("overview", "Overview", Overview, "curve"),
    tab("checkpoints", "Checkpoints", Checkpoints, "checkpoints"),
    tab("evaluations", "Evaluations", Evaluations, "evaluations"),
    tab("files", "Settings and files", Files, "files"),
    tab("notes", "Notes", Notes, "notes"),
  ];
  const { model, training, trains, badges, story, figures, actions } = about;
  return html`
    ${all}
    <h1>${prefix} <${Badges} badges=${badges} /></h1>
    <p class="state" role="status">${story} <${Origin} training=${training} note=${model?.note} names=${names} /></p>
    ${!trains && training?.state === "failed" && training.message && html`<${Failure} error=${training} />`}
    <${Tiles} values=${figures} />
    <div class="actions" role="group" aria-label="What to do with this model">
      ${
        trains
          ? html`<${Act} key="stop" class="danger" action=${action("stop")} text="Stop the training" />`
          : html`<${Act} key="resume" action=${action("start")} text="Resume the training" />`
      }
      <${Act} class="main" action=${action("evaluate")} text="Evaluate" />
      ${running.length > 0 && html`<${Act} action=${stopEvaluation(prefix)} text="Stop the evaluation" />`}
      ${actions.map(([name, text]) => html`<${Act} key=${name} action=${action(name)} text=${text} />`)}
    </div>
    <${Tabs} label=${`Parts of ${prefix}`} parts=${tabs} chosen=${query.get("tab") ?? "overview"} onChoose=${(tab) => setQuery({ tab: tab === "overview" ? "" : tab }, true)} />`;
}

/** Which model it began with, and what its racer says about it. */
function Origin({ training, note, names }) {
  const { parent, parent_checkpoint: checkpoint } = training ?? {};
  const link = names.includes(parent) ? html`<a href=${modelLink(parent)}>${parent}</a>` : parent;
  return html`
    ${parent && html`It began with the weights of ${link}, checkpoint ${checkpoint.split("_")[0]}. `}
    ${note && html`<q>${note}</q>`}`;
}
