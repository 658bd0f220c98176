// Evaluations: the one that drives now, stored ones with their trials, two side by side, and their videos.

import { SelectField } from "/fields.js";
import { Worker } from "/live_worker.js";
import { stopEvaluation } from "/model_actions.js";
import { Act } from "/model_page.js";
import { useGet, useTopic } from "/store.js";
import { lapTime, number, stampText } from "/text.js";
import { Empty, Failure, Table, html, useState } from "/ui.js";

const VIEWS = {
  "camera-pip": "from behind, with the camera",
  "camera-45degree": "from behind",
  "camera-topview": "from above",
};
const spoken = (word) => word.toLowerCase().replaceAll("_", " ");
const joined = (parts, by) => parts.filter(Boolean).join(by);
const known = (value) => (value ?? null) !== null;
/** How a trial ended; a finished lap may have resets and penalties. */
const ended = (trial) =>
  trial.clean ? "Clean lap" : trial.status === "Lap complete" ? "Finished" : trial.status;
const sum = (each, name) => String(each.trials.reduce((total, trial) => total + trial[name], 0));
const labelOf = (each) =>
  joined(
    [
      stampText(each.stamp),
      each.world,
      each.reverse && "reverse",
      each.checkpoint && `checkpoint ${each.checkpoint.split("_")[0]}`,
      `${each.clean_laps} of ${each.trials.length} laps clean`,
      known(each.best_lap_s) && lapTime(each.best_lap_s),
    ],
    " · ",
  );

/** @param {{prefix: string, path: (name: string) => string, version: any, running: Object[], action: Function}} props */
export function Evaluations({ prefix, path, version, running, action }) {
  const { value: list, error } = useGet(path("evaluations"), version);
  const [chosen, setChosen] = useState({ one: "", other: "" });
  const stored = list?.evaluations ?? [];
  // A new result is shown at once, unless an older one was chosen.
  const one = stored.find((each) => each.stamp === chosen.one) ?? stored[0];
  const other = stored.find((each) => each.stamp === chosen.other);
  const options = stored.map((each) => [each.stamp, labelOf(each)]);
  const choose = (name) => (stamp) => setChosen({ ...chosen, [name]: stamp });
  return html`
    ${running.map((each) => html`<${Running} key=${each.stamp} prefix=${prefix} evaluation=${each} />`)}
    ${error && html`<${Failure} error=${error} />`}
    ${
      list &&
      !one &&
      !running.length &&
      html`<${Empty} text="This model has no stored evaluation yet.">
      <${Act} class="main" action=${action("evaluate")} text="Evaluate it" />
    <//>`
    }
    ${
      one &&
      html`
      <div class="model-tools">
        <${SelectField} label="Evaluation" options=${options} value=${one.stamp} onChange=${choose("one")} />
        ${stored.length > 1 && html`<${SelectField} label="Compare with" options=${[["", "nothing"], ...options]} value=${chosen.other} onChange=${choose("other")} />`}
      </div>
      ${list.total > stored.length && html`<p class="quiet">The newest ${stored.length} of ${list.total} evaluations are listed.</p>`}
      ${other && other !== one ? html`<${Comparison} one=${one} other=${other} />` : html`<${Single} one=${one} />`}
      <${Film} key=${one.stamp} prefix=${prefix} path=${path} one=${one} action=${action} videos=${list.videos} isNewest=${one === stored[0]} />`
    }`;
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
  const { off_track_penalty_s: off, collision_penalty_s: hit } = one;
  const rows = one.trials.map((trial) => [
    ...[String(trial.trial), trial.time_text, `${number(trial.progress)} %`, ended(trial)],
    ...[trial.off_track, trial.crashes, trial.resets].map(String),
  ]);
  const facts = [
    one.world && `Track ${one.world}${one.reverse ? ", in reverse" : ""}`,
    one.race_type && spoken(one.race_type),
    one.checkpoint && `checkpoint ${one.checkpoint}`,
    one.summary,
  ];
  return html`
    <p>${joined(facts, "; ")}.</p>
    <${Table} caption="Trials" heads=${["Trial", "Time", "Completed", "Status", "Off-tracks", "Crashes", "Resets"]} rows=${rows} />
    <p class="quiet fine">Times are those of the simulation, penalties included.${known(off) && ` Leaving the track costs ${number(off, 1)} s, a crash ${number(hit, 1)} s.`}</p>`;
}

/** @type {[string, (each: any) => string, ((each: any) => number)?][]} */
const FIGURES = [
  ["Track", (each) => each.world || "–"],
  ["Direction", (each) => (known(each.reverse) ? (each.reverse ? "reverse" : "as built") : "–")],
  ["Checkpoint", (each) => each.checkpoint || "–"],
  ["Clean laps", (each) => `${each.clean_laps} of ${each.trials.length}`],
  ["Finished laps", (each) => `${each.complete_laps} of ${each.trials.length}`],
  ["Best clean lap", (each) => lapTime(each.best_lap_s), (each) => each.best_lap_s],
  [
    "Mean of finished laps, with penalties",
    (each) => lapTime(each.mean_lap_s),
    (each) => each.mean_lap_s,
  ],
  ["Off-tracks", (each) => sum(each, "off_track")],
  ["Crashes", (each) => sum(each, "crashes")],
  ["Resets", (each) => sum(each, "resets")],
];

function Comparison({ one, other }) {
  const names = [stampText(one.stamp), stampText(other.stamp)];
  const difference = (value) => {
    const [a, b] = [value?.(one), value?.(other)];
    return known(a) && known(b) ? `${a - b > 0 ? "+" : "−"}${number(Math.abs(a - b), 3, "s")}` : "";
  };
  const trial = (each, k) =>
    each.trials[k] ? `${each.trials[k].time_text}, ${ended(each.trials[k]).toLowerCase()}` : "–";
  const count = Math.max(one.trials.length, other.trials.length);
  return html`
    <${Table} caption="Two evaluations" heads=${["Figure", ...names, "Difference"]}
      rows=${FIGURES.map(([name, text, value]) => [name, text(one), text(other), difference(value)])} />
    <${Table} caption="Their trials" heads=${["Trial", ...names]}
      rows=${Array.from({ length: count }, (_, k) => [String(k + 1), trial(one, k), trial(other, k)])} />
    ${one.world && other.world && one.world !== other.world && html`<p class="quiet">The tracks differ, so times cannot be compared.</p>`}`;
}

function Film({ prefix, path, one, action, videos, isNewest }) {
  const own = videos.filter((name) => name === `evaluation-${one.stamp}/video.mp4`);
  const names = [...own, ...(isNewest ? videos.filter((name) => name.startsWith("mp4/")) : [])];
  const [chosen, setChosen] = useState("");
  const query = new URLSearchParams({
    model: prefix,
    trace: `evaluation-${one.stamp}/evaluation-simtrace/0-iteration.csv`,
    episode: "0",
  });
  const more =
    one.trace &&
    html`
    <${Act} action=${action("film", { stamp: one.stamp })} text=${own.length ? "Make another video" : "Make a video"} />
    <a class="button" href=${`#/play?${query}`}>Step by step</a>`;
  if (!names.length)
    return html`<h2>Video</h2><${Empty} text=${
      one.trace
        ? "There is no video of this evaluation yet; it can be made from its stored steps."
        : "There is no video of this evaluation, and its steps are not stored."
    }>${more}<//>`;
  const name = names.includes(chosen) ? chosen : names[0];
  const source = `${path("video")}&name=${encodeURIComponent(name)}`;
  const label = (each) =>
    each.startsWith("mp4/")
      ? `newest evaluation, ${VIEWS[each.split("/")[1]] ?? each}`
      : "this evaluation";
  return html`
    <h2>Video</h2>
    ${names.length > 1 && html`<${SelectField} label="View" options=${names.map((each) => [each, label(each)])} value=${name} onChange=${setChosen} />`}
    <video class="model-video" controls preload="metadata" key=${source} src=${source} aria-label=${`Video of the evaluation of ${stampText(one.stamp)}`}></video>
    <p class="actions"><a class="button" href=${`${source}&download`} download="">Download the video</a>${more}</p>`;
}
