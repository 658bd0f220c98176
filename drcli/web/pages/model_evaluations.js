// Evaluations: the one that drives now, stored ones with their trials, two side by side, and their videos.

import { Field } from "/fields.js";
import { Worker } from "/live_worker.js";
import { stopEvaluation } from "/model_actions.js";
import { Act, useGet, useTopic } from "/store.js";
import { number } from "/text.js";
import { Empty, Loaded, Table, html, useState } from "/ui.js";

/** @param {{prefix: string, path: (name: string) => string, version: any, running: Object[], action: Function}} props */
export function Evaluations({ version, running, ...props }) {
  const found = useGet(props.path("evaluations"), version);
  return html`
    ${running.map((each) => html`<${Running} key=${each.stamp} prefix=${props.prefix} evaluation=${each} />`)}
    <${Loaded} found=${found}>${(list) => html`<${Stored} ...${props} ...${list} isRunning=${running.length > 0} />`}<//>`;
}

function Stored({ evaluations, total, isRunning, ...props }) {
  const [chosen, setChosen] = useState({ one: "", other: "" });
  // A new result is shown at once, unless an older one was chosen.
  const one = evaluations.find((each) => each.stamp === chosen.one) ?? evaluations[0];
  const other = evaluations.find((each) => each.stamp === chosen.other);
  const options = evaluations.map((each) => [each.stamp, each.label]);
  if (!one)
    return (
      !isRunning &&
      html`<${Empty} text="This model has no stored evaluation yet.">
        <${Act} class="main" action=${props.action("evaluate")} text="Evaluate it" />
      <//>`
    );
  return html`
    <div class="model-tools">
      <${Field} label="Evaluation" options=${options} value=${one.stamp} set=${(stamp) => setChosen({ ...chosen, one: stamp })} />
      ${options.length > 1 && html`<${Field} label="Compare with" options=${[["", "nothing"], ...options]} value=${chosen.other} set=${(stamp) => setChosen({ ...chosen, other: stamp })} />`}
    </div>
    ${total > options.length && html`<p class="quiet">The newest ${options.length} of ${total} evaluations are listed.</p>`}
    ${other && other !== one ? html`<${Comparison} one=${one} other=${other} />` : html`<${Single} one=${one} />`}
    <${Film} key=${one.stamp} ...${props} one=${one} />`;
}

/** What drives now: camera, map and figures, and a button that ends it. */
function Running({ evaluation: { stamp, checkpoint, world, started_at: began }, prefix }) {
  const worker = useTopic("workers").value?.workers.find(
    (each) => each.worker === `evaluation-${stamp}`,
  );
  return html`
    <div class="empty">
      <p role="status">An evaluation has been running since ${new Date(began * 1000).toLocaleTimeString("en-GB")}: ${checkpoint} on ${world}. Its result appears here.</p>
      <p class="actions"><${Act} class="danger" action=${stopEvaluation(prefix)} text="Stop it" /></p>
    </div>
    ${worker && html`<${Worker} runId=${worker.run_id} name=${worker.worker} facts=${{ world, activity: "", place: "live", car: worker.car }} />`}`;
}

function Single({ one }) {
  if (one.problem) return html`<div class="problem"><p>${one.problem}</p></div>`;
  return html`
    <p>${one.about}</p>
    <${Table} caption="Trials" heads=${["Trial", "Time", "Completed", "Status", "Off-tracks", "Crashes", "Resets"]} rows=${one.rows} />
    <p class="quiet fine">${one.footnote}</p>`;
}

function Comparison({ one, other }) {
  const names = [one.name, other.name];
  const figures = one.figures.map(([name, text, seconds], k) => {
    const [, otherText, otherSeconds] = other.figures[k];
    const gap = seconds - otherSeconds;
    const isKnown = seconds !== null && otherSeconds !== null;
    const difference = isKnown ? `${gap > 0 ? "+" : "−"}${number(Math.abs(gap), 3, "s")}` : "";
    return [name, text, otherText, difference];
  });
  const trial = ({ rows }, k) => (rows[k] ? `${rows[k][1]}, ${rows[k][3].toLowerCase()}` : "–");
  const count = Math.max(one.trials.length, other.trials.length);
  return html`
    <${Table} caption="Two evaluations" heads=${["Figure", ...names, "Difference"]} rows=${figures} />
    <${Table} caption="Their trials" heads=${["Trial", ...names]}
      rows=${Array.from({ length: count }, (_, k) => [String(k + 1), trial(one, k), trial(other, k)])} />
    ${one.world && other.world && one.world !== other.world && html`<p class="quiet">The tracks differ, so times cannot be compared.</p>`}`;
}

function Film({ prefix, path, one, action }) {
  const [chosen, setChosen] = useState("");
  const query = new URLSearchParams({
    model: prefix,
    trace: `evaluation-${one.stamp}/evaluation-simtrace/0-iteration.csv`,
    episode: "0",
  });
  const { films, trace } = one;
  const make = films.length ? "Make another video" : "Make a video";
  const more =
    trace &&
    html`
    <${Act} action=${action("film", { stamp: one.stamp })} text=${make} />
    <a class="button" href=${`#/play?${query}`}>Step by step</a>`;
  if (!films.length) {
    const why = trace
      ? "yet; it can be made from its stored steps."
      : "and its steps are not stored.";
    return html`<h2>Video</h2><${Empty} text=${`There is no video of this evaluation ${why}`}>${more}<//>`;
  }
  const name = films.some(([each]) => each === chosen) ? chosen : films[0][0];
  const source = `${path("video")}&name=${encodeURIComponent(name)}`;
  return html`
    <h2>Video</h2>
    ${films.length > 1 && html`<${Field} label="View" options=${films} value=${name} set=${setChosen} />`}
    <video class="model-video" controls preload="metadata" key=${source} src=${source} aria-label=${`Video of the evaluation of ${one.name}`}></video>
    <p class="actions"><a class="button" href=${`${source}&download`} download="">Download the video</a>${more}</p>`;
}
