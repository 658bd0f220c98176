// The checkpoints of a model, how each of them drove, and what can be done with it.

import { Act } from "/model_page.js";
import { bytes, lapTime, number } from "/text.js";
import { Empty, Failure, Table, html } from "/ui.js";

const WORDS = {
  last: "the newest",
  best: "the best",
  "first-lap": "of the first lap",
  "three-laps": "of three laps in one evaluation",
  "best-lap": "of the best lap",
};
const FORMATS = { tensorflow: ["TensorFlow", "Of DeepRacer-for-Cloud or a console"] };

const Marks = ({ entry }) =>
  [
    ...entry.words.map((word) => [word, `Checkpoint ${WORDS[word] ?? word}`]),
    entry.untaught && ["untaught", "Until there, only the teacher has learned"],
    entry.every && ["kept every n", "DR_TRAIN_KEEP_CHECKPOINT_EVERY"],
    FORMATS[entry.form],
  ]
    .filter(Boolean)
    .map(([text, about]) => html`<span class="model-badge" title=${about}>${text}</span> `);

/** @param {{value: any, error: any, action: Function}} props the answer of /api/model/checkpoints */
export function Checkpoints({ value, error, action }) {
  if (error)
    return error.code === 3
      ? html`<${Empty} text=${`${error.message} ${error.remedy}`} />`
      : html`<${Failure} error=${error} />`;
  if (!value) return null;
  const { checkpoints, damaged, milestones, not_reached: missing } = value;
  const broken = checkpoints.some((each) => each.problem);
  const rows = [...checkpoints].reverse().map((each) => {
    const act = (name, text) =>
      html`<${Act} action=${action(name, { checkpoint: String(each.number) })} text=${text} />`;
    return [
      String(each.number),
      html`<${Marks} entry=${each} />`,
      each.episodes ? `${each.laps} of ${each.episodes}` : "–",
      (each.progress ?? null) === null ? "–" : number(each.progress, 1, "%"),
      lapTime(each.median_s),
      lapTime(each.best_lap_s),
      bytes(each.size_bytes),
      html`<span class="actions">${act("evaluate", "Evaluate")}${act("clone", "Clone")} ${act("submit", "Submit")}${act("download", "Download")}</span>`,
      ...(broken ? [each.problem] : []),
    ];
  });
  const gone = milestones.filter((each) => !each.kept);
  return html`
    ${damaged.map((each) => html`<div class="problem"><p>${each}</p></div>`)}
    <${Table} caption="Checkpoints" rows=${rows} heads=${["Number", "Marks", "Clean laps", "Progress", "Median lap", "Best lap", "Size", "Actions", ...(broken ? ["Problem"] : [])]} />
    <p class="quiet fine">Laps are those of evaluations during the training, which end at the first violation. Together ${bytes(value.size_bytes)}. A training keeps the newest four checkpoints, the best one and the milestones.${missing.length > 0 && ` Not reached yet: ${missing.join(", ")}.`}</p>
    ${gone.length > 0 && html`<p class="quiet fine">Milestones whose checkpoints are gone: ${gone.map((each) => `${each.word} (${each.checkpoint})`).join(", ")}.</p>`}`;
}
