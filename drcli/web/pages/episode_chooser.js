// Chooses a stored episode: model, training or evaluation, iteration, worker, episode; all with numbers.

import { playPath } from "/episode_data.js";
import { setQuery, useGet } from "/store.js";
import { andResets, duration, lapTime, moment, number, stampText } from "/text.js";
import { Choice, Empty, Failure, html, useState } from "/ui.js";

const KINDS = { training: "Training", evaluation: "Evaluations", opponent: "Race as the opponent" };
const MARKS = { best: "good-mark", worst: "bad-mark" };

/** What a trace is called on the page. */
export function traceTitle({ kind, iteration, worker, stamp }) {
  if (kind === "training") return `Iteration ${iteration}${worker ? `, worker ${worker}` : ""}`;
  return kind === "evaluation" ? `Evaluation of ${stampText(stamp)}` : "Last race as the opponent";
}

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
            options=${drives.map((each) => [each.name, optionText(each)])}
            onChange=${(value) => take(traces.find((each) => each.name === value))} />`
        }
      </div>
      <div class="chooser-episodes" aria-live="polite">${list()}</div>
    </div>`;
}

function optionText(trace) {
  const {
    mean_progress: progress,
    mean_reward: reward,
    clean_laps: clean,
    full_laps: full,
  } = trace;
  const numbers = [
    progress !== null && `progress ${number(progress, 0)} %`,
    reward !== null && `reward ${number(reward, 1)}`,
    clean != null && `${clean} clean laps${andResets(trace.resets)}`,
    clean == null && full && `${full} clean laps`,
    trace.best_lap_s != null && `best ${number(trace.best_lap_s, 2)} s`,
  ]
    .filter(Boolean)
    .join(", ");
  const name = {
    training: () => `Iteration ${trace.iteration}`,
    evaluation: () => `${stampText(trace.stamp)}${trace.iteration ? ` (${trace.iteration})` : ""}`,
    opponent: () => moment(trace.modified),
  }[trace.kind]();
  return numbers ? `${name}: ${numbers}` : name;
}

function Episodes({ facts, link, action, current }) {
  const start = (share) =>
    share === null ? "–" : `${number(Math.round(share) % 100, 0)} % of the lap`;
  const title = `${traceTitle(facts)}${facts.world ? ` on ${facts.world}` : ""}`;
  return html`
    <div class="scroll" tabindex="0" role="region" aria-label="Episodes">
      <table>
        <caption>${title}</caption>
        <thead><tr>
          <th scope="col"><span class="unseen">Action</span></th>
          ${["Episode", "Reward", "Progress", "Time", "Ended", "Resets", "Start", "Steps"].map(
            (head) => html`<th key=${head} scope="col">${head}</th>`,
          )}
        </tr></thead>
        <tbody>${facts.episodes.map(
          (each) => html`
          <tr key=${each.index} class=${each.index === current ? "current" : null}>
            <td>${
              each.index === current
                ? "shown"
                : html`<a class="button short" href=${link(each.index)} aria-label=${`${action} episode ${each.number}`}>${action}</a>`
            }</td>
            <th scope="row">${each.number} ${each.mark && html`<strong class=${`mark ${MARKS[each.mark]}`}>${each.mark}</strong>`}</th>
            <td class="number">${number(each.reward, 1)}</td>
            <td class="number">${number(each.progress, 1, "%")}</td>
            <td class="number">${each.completed ? lapTime(each.seconds) : duration(each.seconds)}</td>
            <td>${each.text}</td>
            <td class="number">${each.resets}</td>
            <td class="number">${start(each.start_percent)}</td>
            <td class="number">${each.steps}</td>
          </tr>`,
        )}</tbody>
      </table>
    </div>`;
}
