// One model: numbers, reward graph, checkpoints, evaluations, files, notes, and what can be done with it.

import { modelActions, stopEvaluation } from "/model_actions.js";
import { Checkpoints } from "/model_checkpoints.js";
import { Evaluations } from "/model_evaluations.js";
import { Files } from "/model_files.js";
import { Notes } from "/model_notes.js";
import { Overview } from "/model_overview.js";
import { Badges, checkpointText, modelLink } from "/models_page.js";
import { setQuery, useAction, useGet, useTopic } from "/store.js";
import { bytes, duration, lapTime, moment, number } from "/text.js";
import { Button, Failure, Tabs, Tiles, html, useEffect } from "/ui.js";

export const title = "Model";

const STATES = {
  finished: "It has finished its training",
  stopped: "It was stopped",
  interrupted: "It was interrupted",
  failed: "Its training failed",
  lost: "Its training ended without saying why",
};
const AllModels = () => html`<p class="fine"><a href="#/models">All models</a></p>`;

export function Page({ query }) {
  const prefix = query.get("prefix") ?? "";
  return html`<${Model} key=${prefix} prefix=${prefix} query=${query} />`;
}

function Model({ prefix, query }) {
  const path = (name = "") =>
    `/api/model${name ? `/${name}` : ""}?prefix=${encodeURIComponent(prefix)}`;
  const changes = useTopic(`model:${prefix}`);
  const models = useTopic("models").value;
  const now = changes.value;
  const part = (name) => (now ? JSON.stringify(now.parts[name]) : null);
  const version =
    now &&
    ["checkpoints", "curve", "evaluations", "notes"].map(part).join() + now.training + now.current;
  const about = useGet(path(), version);
  const checkpoints = useGet(path("checkpoints"), part("checkpoints"));
  useEffect(() => {
    document.title = `${prefix} – DeepRacer console`;
  }, [prefix]);
  const heading = html`<h1>${prefix || "No model"}</h1>`;
  if (about.error && !changes.value?.exists)
    return html`
    ${heading}<${Failure} error=${about.error} /><p><a class="button" href="#/models">All models</a></p>`;
  if (now && !now.exists)
    return html`
    ${heading}<div class="problem"><p>This model was deleted.</p><${AllModels} /></div>`;
  const error = changes.error ?? about.error;
  if (error) return html`<${AllModels} />${heading}<${Failure} error=${error} />`;
  if (!about.value) return html`${heading}<p role="status">Reading the model ...</p>`;
  const own = models?.models.find((each) => each.model.prefix === prefix);
  const known = {
    ...about.value,
    ...(own && { model: own.model, training: own.training ?? about.value.training }),
  };
  const names = models?.models.map((each) => each.model.prefix) ?? [];
  const action = modelActions(prefix);
  const parts = [
    [
      "overview",
      "Overview",
      () => html`<${Overview} prefix=${prefix} path=${path} version=${part("curve")} />`,
    ],
    [
      "checkpoints",
      "Checkpoints",
      () => html`<${Checkpoints} ...${checkpoints} action=${action} />`,
    ],
    [
      "evaluations",
      "Evaluations",
      () =>
        html`<${Evaluations} prefix=${prefix} path=${path} version=${part("evaluations")} running=${now?.evaluations ?? []} action=${action} />`,
    ],
    [
      "files",
      "Settings and files",
      () =>
        html`<${Files} prefix=${prefix} path=${path} version=${part("files")} names=${names} other=${query.get("other")} />`,
    ],
    [
      "notes",
      "Notes",
      () => html`<${Notes} prefix=${prefix} path=${path("notes")} version=${part("notes")} />`,
    ],
  ];
  const { model, training } = known;
  const trains = now ? now.training : model?.training;
  const state = {
    trainings: now?.training_here ? [{ prefix }] : [],
    evaluations: (now?.evaluations ?? []).map(() => ({ prefix })),
    current: (now ? now.current : known.current) ? prefix : "",
  };
  return html`
    <${AllModels} />
    <h1>${prefix} <${Badges} prefix=${prefix} data=${state} model=${{ ...model, training: trains }} training=${training} /></h1>
    <p class="state" role="status"><${Story} training=${training} trains=${trains} note=${model?.note} names=${names} /></p>
    ${!trains && training?.state === "failed" && training.message && html`<${Failure} error=${training} />`}
    <${Tiles} values=${[
      ["Best clean lap", lapTime(training?.best_lap_s)],
      ["Best checkpoint", checkpointText(model?.best)],
      ["Last checkpoint", checkpointText(model?.last)],
      ["Iterations", number(training?.iterations)],
      ["Training time", duration(training?.elapsed_s)],
      ["Size", bytes(model?.size_bytes)],
    ]} />
    <div class="actions" role="group" aria-label="What to do with this model">
      ${
        trains
          ? html`<${Act} key="stop" class="danger" action=${action("stop")} text="Stop the training" />`
          : html`<${Act} key="resume" action=${action("start")} text="Resume the training" />`
      }
      <${Act} class="main" action=${action("evaluate")} text="Evaluate" />
      ${state.evaluations.length > 0 && html`<${Act} action=${stopEvaluation(prefix)} text="Stop the evaluation" />`}
      <${Act} action=${action("clone")} text="Clone" />
      <${Act} action=${action("submit")} text="Submit to a race" />
      <${Act} action=${action("download")} text="Download" />
      <${Act} action=${action("upload")} text="Upload" />
      <${Act} action=${action("delete")} text="Delete" />
    </div>
    <${Tabs} label=${`Parts of ${prefix}`} parts=${parts} chosen=${query.get("tab") ?? "overview"} onChoose=${(tab) => setQuery({ tab: tab === "overview" ? "" : tab }, true)} />`;
}

/** A button of an action of the model; `action` says itself what went wrong. */
export function Act({ action, text, class: kind = null }) {
  const [run, busy] = useAction(action);
  return html`<${Button} class=${kind} busy=${busy} onClick=${() => run()}>${text}<//>`;
}

function Story({ training, trains, note, names }) {
  if (!training) return "There is no record of its training.";
  const space = training.action_space?.replace(/^discrete, (\d+)$/, "discrete, $1 actions");
  const facts = [
    training.world,
    training.race_type.toLowerCase().replaceAll("_", " "),
    training.algorithm,
    space,
  ];
  const ended = training.ended_at ? ` (${moment(Date.parse(training.ended_at) / 1000)})` : "";
  const end = STATES[training.state] ? `${STATES[training.state]}${ended}. ` : "";
  const { parent } = training;
  return html`
    ${facts.some(Boolean) ? `${facts.filter(Boolean).join(", ")}. ` : "Track and algorithm of its training are not recorded. "}
    ${trains ? "It is being trained. " : `${end}${training.state !== "failed" && training.message ? `${training.message} ` : ""}`}
    ${parent && html`It began with the weights of ${names.includes(parent) ? html`<a href=${modelLink(parent)}>${parent}</a>` : parent}, checkpoint ${training.parent_checkpoint.split("_")[0]}. `}
    ${note && html`<q>${note}</q>`}`;
}
