// Evaluations: the one that drives now, stored ones with their trials, two side by side, and their videos.

import { SelectField } from "/fields.js";
import { Worker } from "/live_worker.js";
import { stopEvaluation } from "/model_actions.js";
import { Act } from "/model_page.js";
import { useGet, useTopic } from "/store.js";
import { number } from "/text.js";
import { Empty, Failure, Table, html, useState } from "/ui.js";

const VIEWS = {
  "camera-pip": "from behind, with the camera",
  "camera-45degree": "from behind",
  "camera-topview": "from above",
};

/** @param {{prefix: string, path: (name: string) => string, version: any, running: Object[], action: Function}} props */
export function Evaluations({ prefix, path, version, running, action }) {
  const { value: list, error } = useGet(path("evaluations"), version);
  const [chosen, setChosen] = useState({ one: "", other: "" });
  const stored = list?.evaluations ?? [];
  // A new result is shown at once, unless an older one was chosen.
  const one = stored.find((each) => each.stamp === chosen.one) ?? stored[0];
  const other = stored.find((each) => each.stamp === chosen.other);
  const options = stored.map((each) => [each.stamp, each.label]);
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
    <video class="model-video" controls preload="metadata" key=${source} src=${source} aria-label=${`Video of the evaluation of ${one.name}`}></video>
    <p class="actions"><a class="button" href=${`${source}&download`} download="">Download the video</a>${more}</p>`;
}
