// The reward graph of a training as consoles draw it, and what dr-analyze says about it.

import { RewardPlot } from "/learning_plots.js";
import { useTrack } from "/live_picture.js";
import { runTask } from "/model_tasks.js";
import { useAction, useGet } from "/store.js";
import { lapTime, moment, number } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Button, Empty, Failure, Tick, html, useMemo, useState } from "/ui.js";

const PARTS = 10; // of a training, of which one is shown

export function Overview({ prefix, path, version }) {
  const { value, error } = useGet(path("curve"), version);
  return html`
    ${error && html`<${Failure} error=${error} />`}
    ${value && html`<${RewardPlot} ...${value} height=${320} />`}
    <${Analysis} prefix=${prefix} path=${path} />`;
}

/** Verdict and advice; a button reads the training again. */
function Analysis({ prefix, path }) {
  const { value, error, reload } = useGet(path("report/about"));
  const [analyse, busy] = useAction(async () => {
    await runTask("/api/model/analyse", { prefix });
    reload();
  });
  const { written, analysis } = value ?? {};
  const report = path("report");
  return html`
    <section aria-labelledby="analysis">
      <h2 id="analysis">Verdict and advice</h2>
      <div role="status">${
        busy
          ? html`<p class="quiet">The training is read and analysed. This takes some seconds; a long training takes longer.</p>`
          : analysis
            ? html`<${Verdict} found=${analysis} />`
            : value &&
              !written &&
              html`<${Empty} text="A verdict and advice are worked out from traces, curves and evaluations, with a report of graphs, map and laps." />`
      }
      </div>
      ${error && html`<${Failure} error=${error} />`}
      <p class="actions">
        <${Button} busy=${busy} onClick=${analyse}>${written ? "Analyse again" : "Analyse"}<//>
        ${
          written &&
          html`<a class="button" href=${report} target="_blank" rel="noopener">Open the full report</a>
          <a class="button" href=${`${report}&download`} download="">Download it</a>
          <span class="quiet fine">written ${moment(written)}</span>`
        }
      </p>
    </section>`;
}

/** Where episodes ended before their lap was complete, by iteration. @param {{ends: number[][], world: string}} props */
export function Ends({ ends, world }) {
  const { lines } = useTrack(world);
  const newest = Math.max(...ends.map(([iteration]) => iteration));
  const span = Math.max(1, Math.ceil((newest + 1) / PARTS));
  const [last, setLast] = useState(newest);
  const [all, setAll] = useState(true);
  const from = all ? 0 : Math.max(0, last - span + 1);
  const to = all ? newest : last;
  const dots = useMemo(
    () =>
      ends.filter(([iteration]) => iteration >= from && iteration <= to).map(([, x, y]) => [x, y]),
    [ends, from, to],
  );
  const text = `${number(dots.length)} episodes of iterations ${from} to ${to} ended before their lap was complete.`;
  return html`
    <figure class="chart">
      <figcaption><strong>Where it fails</strong> Darker: more episodes ended there.</figcaption>
      <${TrackMap} label=${`Map of the ends of episodes. ${text}`} height=${360} track=${lines} dots=${dots} />
      <p class="actions">
        <${Tick} label="All iterations" on=${all} set=${setAll} />
        <label class="choice"><span>or those until</span><input type="range" min=${span - 1} max=${newest} value=${last} disabled=${all}
          aria-label="Newest iteration that is shown" onInput=${(event) => setLast(Number(event.currentTarget.value))} /></label>
      </p>
      <p class="readout" role="status">${text}</p>
    </figure>`;
}

function Verdict({ found }) {
  const best =
    (found.best_lap_s ?? null) === null ? "." : `, the best in ${lapTime(found.best_lap_s)}.`;
  return html`
    <p class="model-verdict"><strong>${found.verdict.sentence}</strong></p>
    <p class="quiet">${number(found.episodes)} episodes, ${number(found.complete_laps)} clean laps${best}${found.limit && ` ${found.limit}.`}</p>
    ${
      found.advice.length
        ? html`<ol class="model-advice">${found.advice.map(
            (each) => html`<li>
      <strong>${each.title}</strong><p>${each.evidence}</p>
      ${each.setting && html`<p class="fine quiet">Setting: ${each.setting}</p>`}
      ${each.command && html`<p><code>${each.command}</code></p>`}
    </li>`,
          )}</ol>`
        : html`<p>There is no advice: nothing stands out.</p>`
    }
    ${found.ends?.length > 0 && html`<${Ends} ends=${found.ends} world=${found.world} />`}
    ${
      found.problems.length > 0 &&
      html`<details><summary>${found.problems.length} remarks about the files</summary>
      <ul>${found.problems.map((each) => html`<li>${each}</li>`)}</ul></details>`
    }`;
}
