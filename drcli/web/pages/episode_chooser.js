// Chooses a stored episode: model, training or evaluation, iteration, worker, episode; all with numbers.

import { playPath } from "/episode_data.js";
import { setQuery, useGet } from "/store.js";
import { duration, lapTime, number } from "/text.js";
import { Choice, Empty, Failure, Table, html, useState } from "/ui.js";

const KINDS = { training: "Training", evaluation: "Evaluations", opponent: "Race as the opponent" };
const MARKS = { best: "good-mark", worst: "bad-mark" };

/**
 * @param {{chosen: {model?: string, trace?: string, episode?: string}, link: (chosen: Object) => string, action: string}} props
 *   link gives the address of a chosen episode, action is what its link is called.
 */
export function EpisodeChooser({ chosen, link, action }) {
  const [picked, pick] = useState({ model: chosen.model, trace: chosen.trace });
  const listed = useGet(playPath("models"));
  const { models = [], own = "" } = listed.value ?? {};
  const model =
    [picked.model, chosen.model ? "" : own].find((each) => models.includes(each)) ?? models[0];
  const stored = useGet(model ? playPath("traces", { model }) : null);
  const traces = stored.value?.traces ?? [];
  const of = (kind) => traces.filter((each) => each.kind === kind);
  const trace =
    traces.find((each) => each.name === picked.trace) ??
    of("evaluation").at(-1) ??
    of("training").find((each) => each.iteration === of("training").at(-1).iteration) ??
    traces.at(-1);
  const opened = useGet(trace ? playPath("open", { model, trace: trace.name }) : null);

  const take = (found) => pick({ model, trace: found.name });
  const pickModel = (value) => {
    pick({ model: value, trace: "" });
    if (!chosen.trace) setQuery({ model: value });
  };
  const kind = trace?.kind;
  const kinds = Object.keys(KINDS).filter((each) => of(each).length);
  const workers = [...new Set(of(kind).map((each) => each.worker))].sort((a, b) => a - b);
  const drives =
    kind === "training"
      ? of(kind).filter((each) => each.worker === trace.worker)
      : of(kind).reverse();
  const pickWorker = (value) => {
    const others = of(kind).filter((each) => each.worker === Number(value));
    take(others.find((each) => each.iteration === trace.iteration) ?? others.at(-1));
  };
  const failed = [listed, stored, opened].find((each) => each.error);
  const wait = (text) => html`<p class="quiet">${text}</p>`;
  const list = () => {
    if (failed)
      return html`<${Failure} error=${failed.error} />
        <p><button type="button" onClick=${failed.reload}>Try again</button></p>`;
    if (!listed.value) return wait("The models in the bucket are listed …");
    if (!models.length)
      return html`<${Empty} text="There is no model in the bucket yet. Train one, and every episode that it drives can be played here.">
        <a class="button" href="#/">Open the live page</a><//>`;
    if (!stored.value) return wait(`The stored episodes of ${model} are listed …`);
    if (!trace)
      return html`<${Empty} text=${`${model} has no stored episodes: it was neither trained nor evaluated here, or its traces were deleted (DR_TRAIN_TRACES_MAX_MB).`}>
        <a class="button" href=${`#/model?${new URLSearchParams({ prefix: model })}`}>Open the model</a> to evaluate it<//>`;
    if (!opened.value)
      return wait("The episodes are read; the first time this takes some seconds …");
    return html`${opened.value.notes.map((note) => html`<p key=${note} class="problem">${note}</p>`)}
      <${Episodes} facts=${opened.value} action=${action}
        link=${(episode) => link({ model, trace: trace.name, episode })}
        current=${chosen.trace === trace.name && chosen.model === model ? Number(chosen.episode) : -1} />`;
  };
  return html`
    <div class="chooser">
      <div class="chooser-selects">
        <${Choice} label="Model" options=${models} value=${model} onChange=${pickModel} />
        ${
          kinds.length > 1 &&
          html`<${Choice} key="kind" label="Driven in" options=${kinds.map((each) => [each, KINDS[each]])}
            value=${kind} onChange=${(value) => take(of(value).at(-1))} />`
        }
        ${
          workers.length > 1 &&
          html`<${Choice} key="worker" label="Worker" options=${workers.map((each) => [String(each), `Worker ${each}`])}
            value=${String(trace.worker)} onChange=${pickWorker} />`
        }
        ${
          trace &&
          html`<${Choice} key="trace" label=${kind === "training" ? "Iteration" : "Drive"} value=${trace.name}
            options=${drives.map((each) => [each.name, each.text])}
            onChange=${(value) => take(traces.find((each) => each.name === value))} />`
        }
      </div>
      <div class="chooser-episodes" aria-live="polite">${list()}</div>
    </div>`;
}

const HEADS = ["Episode", "Reward", "Progress", "Time", "Ended", "Resets", "Start", "Steps"];

function Episodes({ facts, link, action, current }) {
  const start = (share) =>
    share === null ? "–" : `${number(Math.round(share) % 100, 0)} % of the lap`;
  const rows = facts.episodes.map((each) => [
    each.index === current
      ? html`<span class="current">shown</span>`
      : html`<a class="button short" href=${link(each.index)} aria-label=${`${action} episode ${each.number}`}>${action}</a>`,
    html`${each.number} ${each.mark && html`<strong class=${`mark ${MARKS[each.mark]}`}>${each.mark}</strong>`}`,
    ...[number(each.reward, 1), number(each.progress, 1, "%")],
    each.completed ? lapTime(each.seconds) : duration(each.seconds),
    ...[each.text, each.resets, start(each.start_percent), each.steps],
  ]);
  return html`<${Table} caption=${`${facts.title}${facts.world ? ` on ${facts.world}` : ""}`}
    heads=${[html`<span class="unseen">Action</span>`, ...HEADS]} rows=${rows} />`;
}
