// What runs now: how well it drives, pictures and map of a worker, curves; the rest is folded.

import { LossPlots, RewardPlot } from "/learning_plots.js";
import { LogPanel, MachinePanel } from "/live_panels.js";
import { Worker } from "/live_worker.js";
import { mendLink } from "/mend.js";
import { runTask } from "/model_tasks.js";
import { useAction, useGet, useRows, useTopic } from "/store.js";
import {
  Button,
  Choice,
  Empty,
  Failure,
  Folded,
  Prose,
  Tiles,
  Told,
  html,
  useEffect,
  useState,
} from "/ui.js";

export const title = "Live";

const inOrder = (a, b) => a.localeCompare(b, "en", { numeric: true });

export function Page({ query }) {
  const folder = useGet("/api/folder");
  const wanted = /^\d{1,2}$/.exec(query.get("run") ?? "")?.[0];
  // Without a folder that can be read, the topic of the run says what is wrong with the settings.
  const runId = wanted ? Number(wanted) : folder.error ? 0 : folder.value?.run_id;
  if (runId === undefined) return html`<h1>Live</h1>`;
  return html`<${Run} key=${runId} runId=${runId} folder=${folder} />`;
}

function Run({ runId, folder }) {
  const { value: run, error } = useTopic(`run:${runId}`);
  const iterations = useRows(`iterations:${runId}`);
  const episodes = useRows(`episodes:${runId}`);
  const elsewhere = useTopic(`elsewhere:${runId}`).value;
  const runs = useTopic("workers").value?.runs ?? [];
  const [opened, setOpened] = useState(null);
  const [chosen, setChosen] = useState(null);
  const rows = iterations.value ?? NOTHING;
  useEffect(() => {
    if (!error && folder.error) folder.reload();
  }, [error]);

  const cards = new Map();
  for (const card of error ? NOTHING : [...(elsewhere?.cards ?? []), ...(run?.cards ?? [])])
    cards.set(card.name, card);
  const names = [...cards.keys()].sort(inOrder);
  const first = cards.has(chosen)
    ? chosen
    : (names.find((name) => name.startsWith("evaluation")) ?? names[0]);
  const worker = (name) =>
    html`<${Worker} key=${name} runId=${runId} name=${name} facts=${cards.get(name)} />`;
  const fold = (name, text, content) => html`
    <${Folded} title=${text} open=${opened === name} onToggle=${(open) => setOpened(open ? name : opened === name ? null : opened)}>
      ${content}
    <//>`;
  return html`
    <div class="live-head"><h1>Live</h1><${Runs} runId=${runId} runs=${runs} /></div>
    ${error && html`<${Unreadable} error=${error} />`}
    ${!error && !run && html`<p class="live-sentence" role="status">The state of the run is being read.</p>`}
    ${!error && run && html`<${State} run=${run} elsewhere=${elsewhere} />`}
    <div class="live-first">
      <section class="live-watch" aria-labelledby="live-workers">
        <h2 id="live-workers" class="unseen">Workers</h2>
        ${names.length > 1 && html`<${Choice} label="Worker" options=${names} value=${first} onChange=${setChosen} />`}
        ${first && worker(first)}
        ${!first && run && html`<${Empty} text=${run.words.active ? "The simulation workers are starting." : "No worker runs now. Cameras and maps appear here as soon as a training or an evaluation starts."} />`}
      </section>
      <section aria-labelledby="live-learning">
        <h2 id="live-learning" class="unseen">Learning</h2>
        <${RewardPlot} iterations=${rows} episodes=${episodes.value ?? NOTHING} best=${(run?.best?.metric ?? null) === null ? null : run.best.name} />
        ${episodes.error && html`<p class="quiet">${episodes.error.message} The dots are older.</p>`}
      </section>
    </div>
    ${run && !error && html`<${Said} list=${run.words.said.filter(({ kind }) => kind === "good")} />`}
    ${names.length > 1 && fold("workers", `All ${names.length} workers`, html`<div class="live-cards">${names.map(worker)}</div>`)}
    ${fold("losses", "Entropy, losses and speed", html`<${LossPlots} rows=${rows} />`)}
    ${fold("machine", "This machine, cost and requests", html`<${MachinePanel} words=${run?.words} others=${elsewhere?.others} />`)}
    <${LogPanel} runId=${runId} workers=${names} />`;
}

const NOTHING = [];

const Unreadable = ({ error }) => html`
  <section class="live-state" aria-label="State of the run">
    <p class="live-sentence" role="status"><span class="dot bad"></span>The state of the run cannot be read. The page goes on by itself when it can.</p>
    <${Failure} error=${error} />
  </section>`;

function Runs({ runId, runs }) {
  const known = runs.some((run) => run.run_id === runId)
    ? runs
    : [...runs, { run_id: runId, prefix: "nothing yet" }];
  if (known.length < 2) return null;
  return html`<${Choice} label="Run" value=${String(runId)} onChange=${(value) => (location.hash = `#/?run=${value}`)}
    options=${known.map((run) => [String(run.run_id), `${run.run_id}: ${run.prefix}${run.alive ? ", runs" : ""}`])} />`;
}

/** The run in a sentence, what to do next, its figures, and what its watches say. */
export function State({ run, elsewhere }) {
  const { active, own, dot, figures, said } = run.words;
  const away = elsewhere?.host && !active;
  const { sentence, hint } = away ? elsewhere : run.words;
  const [stop, stopping] = useAction(() => runTask("/api/model/stop", { prefix: run.prefix }));
  const [resume, resuming] = useAction(() => runTask("/api/model/start", { prefix: run.prefix }));
  const now = stopping
    ? "It is being stopped: it saves the checkpoint of this moment first."
    : resuming && "It is being started.";
  const failed = run.state === "failed" && !away;
  const mend = failed && mendLink(run.message);
  const link = (text, href, main = false) =>
    html`<a class=${main ? "button main" : "button"} href=${href}>${text}</a>`;
  const prefix = encodeURIComponent(away ? elsewhere.prefix : run.prefix);
  const open = link("Open the model", `#/model?prefix=${prefix}`);
  const actions = {
    away: open,
    none: run.unreachable
      ? ""
      : html`${link("New training", "#/new", true)}${link("Models", "#/models")}`,
    active: html`<${Button} class="danger" busy=${stopping} onClick=${stop}>Stop the training<//>${open}`,
    ended: html`
      ${mend && link(mend.text, mend.href, true)}
      ${own && html`<${Button} class=${mend ? null : "main"} busy=${resuming} onClick=${resume}>Resume the training<//>`}
      ${open}${link("New training", "#/new")}`,
  };
  const is = away ? "away" : active ? "active" : run.state === "none" ? "none" : "ended";
  return html`
    <section class="live-state" aria-label="State of the run">
      <div role="status">
        <p class="live-sentence"><span class=${`dot ${away ? "good" : dot}`}></span>${sentence}</p>
        ${failed && run.message ? html`<${Failure} error=${run} />` : null}
        <p class="quiet"><${Prose} text=${now || hint} /></p>
      </div>
      <p class="actions">${actions[is]}</p>
      ${figures.length > 0 && html`<${Tiles} values=${figures} />`}
      ${run.limit && html`<p class="quiet live-limit">Best clean lap of the best checkpoint: ${run.limit}.</p>`}
      <${Said} list=${said.filter(({ kind }) => kind !== "good")} />
    </section>`;
}

/** What its watches say, what to do, and where. */
const Said = ({ list }) =>
  list.length > 0 &&
  html`<div class="live-said"><ul>${list.map(
    ({ kind, message, remedy }) => html`<li key=${message}>
      <span class=${`dot ${kind}`}></span><${Told} text=${message} remedy=${remedy} link=${mendLink(message)} />
    </li>`,
  )}</ul></div>`;
