// The checkpoints of a model, how each of them drove, and what can be done with it.

import { Act } from "/store.js";
import { bytes, lapTime, number } from "/text.js";
import { Columns, Empty, Failure, Loaded, html } from "/ui.js";

/** @param {{checkpoints: {value: any, error: any}, action: Function}} props the answer of /api/model/checkpoints */
export function Checkpoints({ checkpoints: found, action }) {
  const { error } = found;
  if (error?.code === 3) return html`<${Empty} text=${`${error.message} ${error.remedy}`} />`;
  return html`<${Loaded} found=${found}>${(value) => html`<${Listed} ...${value} action=${action} />`}<//>`;
}

function Listed({ action, checkpoints, damaged, milestones, not_reached: missing, ...more }) {
  const { marks, actions, size_bytes: size } = more;
  const badge = ([text, about]) =>
    html`<span key=${text} class="model-badge" title=${about}>${text}</span> `;
  const act = (number) => (each) =>
    html`<${Act} action=${action(each[0], { checkpoint: String(number) })} text=${each[1]} />`;
  const problems = checkpoints.some((each) => each.problem);
  const columns = [
    ["Number", (each) => String(each.number)],
    ["Marks", (each) => marks[each.number].map(badge)],
    ["Clean laps", ({ laps, episodes }) => (episodes ? `${laps} of ${episodes}` : null)],
    ["Progress", ({ progress }) => number(progress, 1, "%")],
    ["Median lap", ({ median_s: median }) => lapTime(median)],
    ["Best lap", ({ best_lap_s: best }) => lapTime(best)],
    ["Size", (each) => bytes(each.size_bytes)],
    ["Actions", (each) => html`<span class="actions">${actions.map(act(each.number))}</span>`],
    problems && ["Problem", ({ problem }) => problem],
  ].filter(Boolean);
  const gone = milestones.filter((each) => !each.kept);
  return html`
    ${damaged.map((message) => html`<${Failure} key=${message} error=${{ message }} />`)}
    <${Columns} caption="Checkpoints" columns=${columns} rows=${[...checkpoints].reverse()} keyOf=${(each) => each.number} />
    <p class="quiet fine">Laps are those of evaluations during the training, which end at the first violation. Together ${bytes(size)}. A training keeps the newest four checkpoints, the best one and the milestones.${missing.length > 0 && ` Not reached yet: ${missing.join(", ")}.`}</p>
    ${gone.length > 0 && html`<p class="quiet fine">Milestones whose checkpoints are gone: ${gone.map((each) => `${each.word} (${each.checkpoint})`).join(", ")}.</p>`}`;
}
