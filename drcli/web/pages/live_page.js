// What runs now: how well it drives, pictures and map of a worker, curves; the rest is folded.

import { LossPlots, RewardPlot } from "/learning_plots.js";
import { LogPanel, MachinePanel } from "/live_panels.js";
import { Worker } from "/live_worker.js";
import { mendLink } from "/mend.js";
import { runTask } from "/model_tasks.js";
import { useAction, useGet, useRows, useTopic } from "/store.js";
import { duration, number } from "/text.js";
import {
  Button,
  Choice,
  Empty,
  Failure,
  Folded,
  Prose,
  Tiles,
  html,
  useEffect,
  useState,
} from "/ui.js";

export const title = "Live";

const WORDS = {
  starting: "starts",
  running: "runs",
  finished: "has finished",
  stopped: "was stopped",
  interrupted: "was interrupted",
  failed: "failed",
  lost: "ended without saying why",
};
const DOTS = {
  ...{ starting: "warn", interrupted: "warn", failed: "bad", lost: "bad" },
  ...{ running: "good", finished: "good" },
};
const inOrder = (a, b) => a.localeCompare(b, "en", { numeric: true });
const modelHref = (prefix) => `#/model?prefix=${encodeURIComponent(prefix)}`;
const isActive = (run) => run.state === "running" || run.state === "starting";
const done = (count) =>
  count === 1 ? "1 iteration is done." : `${number(count)} iterations are done.`;

export function Page({ query }) {
  const folder = useGet("/api/folder");
  const wanted = /^\d{1,2}$/.exec(query.get("run") ?? "")?.[0];
  // Without a folder that can be read, the topic of the run says what is wrong with the settings.
  const runId = wanted ? Number(wanted) : folder.error ? 0 : folder.value?.run_id;
  if (runId === undefined) return html`<h1>Live</h1>`;
  return html`<${Run} key=${runId} runId=${runId} folder=${folder} />`;
}

function Run({ runId, folder }) {
  const run = useTopic(`run:${runId}`);
  const iterations = useRows(`iterations:${runId}`);
  const episodes = useRows(`episodes:${runId}`);
  const elsewhere = useTopic(`elsewhere:${runId}`).value;
  const present = useTopic("workers").value;
  const [opened, setOpened] = useState(null);
  const [chosen, setChosen] = useState(null);
  const rows = iterations.value ?? [];
  useEffect(() => {
    if (!run.error && folder.error) folder.reload();
  }, [run.error]);

  const workers = run.error ? new Map() : knownWorkers(runId, run.value, elsewhere, present);
  const names = [...workers.keys()].sort(inOrder);
  const first = workers.has(chosen)
    ? chosen
    : (names.find((name) => name.startsWith("evaluation")) ?? names[0]);
  const fold = (name, text, content) => html`
    <${Folded} title=${text} open=${opened === name} onToggle=${(open) => setOpened(open ? name : opened === name ? null : opened)}>
      ${content}
    <//>`;
  return html`
    <div class="live-head"><h1>Live</h1><${Runs} runId=${runId} runs=${present?.runs ?? []} /></div>
    ${
      run.error
        ? html`<section class="live-state" aria-label="State of the run">
            <p class="live-sentence" role="status"><span class="dot bad"></span>The state of the run cannot be read. The page goes on by itself when it can.</p>
            <${Failure} error=${run.error} />
          </section>`
        : run.value
          ? html`<${State} runId=${runId} run=${run.value} rows=${rows} elsewhere=${elsewhere} folder=${folder} />`
          : html`<p class="live-sentence" role="status">The state of the run is being read.</p>`
    }
    <div class="live-first">
      <section class="live-watch" aria-labelledby="live-workers">
        <h2 id="live-workers" class="unseen">Workers</h2>
        ${
          names.length > 1 &&
          html`<${Choice} label="Worker" options=${names} value=${first} onChange=${setChosen} />`
        }
        ${first && html`<${Worker} key=${first} runId=${runId} name=${first} facts=${workers.get(first)} />`}
        ${!first && run.value && html`<${Empty} text=${isActive(run.value) ? "The simulation workers are starting." : "No worker runs now. Cameras and maps appear here as soon as a training or an evaluation starts."} />`}
      </section>
      <section aria-labelledby="live-learning">
        <h2 id="live-learning" class="unseen">Learning</h2>
        <${RewardPlot} iterations=${rows} episodes=${episodes.value ?? []} best=${(run.value?.best?.metric ?? null) === null ? null : run.value.best.name} />
        ${episodes.error && html`<p class="quiet">${episodes.error.message} The dots are older.</p>`}
      </section>
    </div>
    ${run.value && !run.error && html`<${Said} list=${notes(run.value).filter(([kind]) => kind === "good")} />`}
    ${
      names.length > 1 &&
      fold(
        "workers",
        `All ${names.length} workers`,
        html`<div class="live-cards">
      ${names.map((name) => html`<${Worker} key=${name} runId=${runId} name=${name} facts=${workers.get(name)} />`)}
    </div>`,
      )
    }
    ${fold("losses", "Entropy, losses and speed", html`<${LossPlots} rows=${rows} />`)}
    ${fold("machine", "This machine, cost and requests", html`<${MachinePanel} run=${run.value} elsewhere=${elsewhere} />`)}
    <${LogPanel} runId=${runId} workers=${names} />`;
}

/** Where each worker can be seen: live here, here but not live, or in the bucket only. */
function knownWorkers(runId, run, elsewhere, present) {
  const found = new Map();
  for (const { name, activity, host } of elsewhere?.host ? elsewhere.workers : [])
    if (name.startsWith("sim-"))
      found.set(name, { place: "bucket", activity, host, world: elsewhere.world });
  for (const worker of run && isActive(run) ? run.workers : [])
    if (worker.name.startsWith("sim-"))
      found.set(worker.name, {
        place: "here",
        activity: worker.alive
          ? worker.activity
          : run.ending
            ? "has ended"
            : "does not run; it is started again",
        alive: worker.alive || run.ending,
        world: run.world,
        restarts: worker.restarts,
      });
  for (const worker of present?.workers ?? [])
    if (worker.run_id === runId)
      found.set(worker.worker, {
        world: null,
        activity: "",
        ...found.get(worker.worker),
        place: "live",
        car: worker.car,
      });
  return found;
}

function Runs({ runId, runs }) {
  const known = runs.some((run) => run.run_id === runId)
    ? runs
    : [...runs, { run_id: runId, prefix: "nothing yet" }];
  if (known.length < 2) return null;
  return html`<${Choice} label="Run" value=${String(runId)} onChange=${(value) => (location.hash = `#/?run=${value}`)}
    options=${known.map((run) => [String(run.run_id), `${run.run_id}: ${run.prefix}${run.alive ? ", runs" : ""}`])} />`;
}

/** The run in a sentence, what to do next, its figures, and what its watches say. */
export function State({ runId, run, rows, elsewhere, folder }) {
  const about = folder.value;
  const own = about?.run_id === runId;
  const away = elsewhere?.host && !isActive(run);
  const [stop, stopping] = useAction(() => runTask("/api/model/stop", { prefix: run.prefix }));
  const [resume, resuming] = useAction(() => runTask("/api/model/start", { prefix: run.prefix }));
  const link = (text, href, main = false) =>
    html`<a class=${main ? "button main" : "button"} href=${href}>${text}</a>`;
  const failed = run.state === "failed" && !away;
  const head = `The training of ${run.prefix} on ${run.world} ${WORDS[run.state] ?? run.state}.`;
  const open = link("Open the model", modelHref(away ? elsewhere.prefix : run.prefix));
  let sentence, hint, actions;
  if (away) {
    sentence = `The training of ${elsewhere.prefix} runs on ${elsewhere.host}, last heard from ${duration(elsewhere.heard_s)} ago.`;
    hint =
      "This page reads the bucket: figures and maps of finished iterations come every few seconds. Live pictures are shown on that machine only; stop the training there.";
    actions = open;
  } else if (run.state === "none" && run.unreachable) {
    sentence = `Nothing runs here. Whether ${run.prefix} was trained, or another machine trains it, is unknown.`;
    hint = run.unreachable;
  } else if (run.state === "none") {
    sentence = "There is no training yet.";
    hint =
      "Set one up: name, track, reward function and actions. It takes some minutes; everything can be changed later.";
    actions = html`${link("New training", "#/new", true)}${link("Models", "#/models")}`;
  } else if (isActive(run)) {
    const starts = run.state === "starting";
    sentence = `${head} ${starts ? "The workers load and check everything; the first pictures come in some seconds." : progress(run, rows)}`;
    hint = stopping
      ? "It is being stopped: it saves the checkpoint of this moment first."
      : starts
        ? ""
        : ends(run);
    actions = html`<${Button} class="danger" busy=${stopping} onClick=${stop}>Stop the training<//>${open}`;
  } else {
    const restart =
      own || !about
        ? ""
        : `To resume it, set DR_RUN_ID to ${runId} on the page “Settings”; it is ${about.run_id} there.`;
    sentence = `${head} ${rows.length ? done(rows.length) : ""}`;
    hint = resuming
      ? "It is being started."
      : [...(failed ? [] : [run.message, run.remedy]), restart].filter(Boolean).join(" ");
    const mend = failed && mendLink(run.message);
    const again =
      own &&
      html`<${Button} class=${mend ? null : "main"} busy=${resuming} onClick=${resume}>Resume the training<//>`;
    actions = html`${mend && link(mend.text, mend.href, true)}${again}${open}${link("New training", "#/new")}`;
  }
  return html`
    <section class="live-state" aria-label="State of the run">
      <div role="status">
        <p class="live-sentence"><span class=${`dot ${elsewhere?.host ? "good" : (DOTS[run.state] ?? "")}`}></span>${sentence}</p>
        ${failed && run.message ? html`<${Failure} error=${run} />` : null}
        <p class="quiet"><${Prose} text=${hint} /></p>
      </div>
      <p class="actions">${actions}</p>
      ${run.state !== "none" || rows.length ? html`<${Tiles} values=${figures(run, rows)} />` : null}
      ${run.limit && html`<p class="quiet live-limit">Best clean lap of the best checkpoint: ${run.limit}.</p>`}
      <${Said} list=${notes(run).filter(([kind]) => kind !== "good")} />
    </section>`;
}

function progress(run, rows) {
  const last = rows.at(-1);
  if (run.phase) return `${run.phase.text.replace(/^./, (letter) => letter.toUpperCase())}.`;
  if (!last) return "The first iteration is being driven.";
  const laps = last.full_laps
    ? `${number(last.full_laps)} of ${number(last.episodes)} episodes completed a clean lap`
    : `the cars got ${number(last.mean_progress, 0, "%")} of the lap on average`;
  return `${done(rows.length)} In the newest, ${laps}.`;
}

function ends(run) {
  const left = [
    run.iterations_left !== null && `${number(run.iterations_left)} iterations`,
    run.time_left_s !== null && duration(run.time_left_s),
    run.money_left !== null && number(run.money_left, 2, "USD"),
  ].filter(Boolean);
  return left.length
    ? `It stops by itself after ${left.join(", or ")} more, or earlier.`
    : "It runs until you stop it, or a goal of its settings is reached.";
}

/** How well it drives first, then how far it is. */
function figures(run, rows) {
  const last = rows.at(-1);
  const newest = run.newest_laps;
  const best = run.best_laps;
  const seconds = (value) => number(value, 2, "s");
  return [
    [
      "Clean laps",
      newest
        ? `${number((100 * newest.clean) / newest.laps, 0, "%")} (${newest.clean} of ${newest.laps})`
        : "–",
    ],
    ["Median clean lap", newest ? seconds(newest.median_s) : "–"],
    [
      "Best checkpoint",
      best ? `${best.checkpoint}: ${best.clean} of ${best.laps}, ${seconds(best.median_s)}` : "–",
    ],
    ["Mean reward", number(last?.mean_reward, 1)],
    ["Mean progress", number(last?.mean_progress, 0, "%")],
    [
      "Iterations done",
      rows.length
        ? `${number(rows.length)}${run.iterations_left === null ? "" : ` of ${number(rows.length + run.iterations_left)}`}`
        : "–",
    ],
    ["Time of training", rows.length ? duration(run.elapsed_s || last.elapsed_s) : "–"],
    ["Steps", last ? `${number(last.total_steps)}, ${number(last.steps_per_s)} a second` : "–"],
  ];
}

/** What its watches say: a kind, a sentence, what to do, and where. */
function notes(run) {
  const errors = run.reward_errors;
  const { convergence } = run;
  return [
    ...(run.dead ?? []).map((name) => [
      "bad",
      `${name} does not run; its supervisor starts it again.`,
    ]),
    ...(run.watches ?? []).map((text) => ["bad", text]),
    ...(run.damaged ?? []).map((text) => ["bad", text]),
    run.warning && ["warn", `Learning curve: ${run.warning}.`, (run.advice ?? []).join(" ")],
    errors?.failed && [
      "bad",
      `The reward function failed in ${number(errors.failed)} of ${number(errors.calls)} calls: ${errors.errors.at(-1)?.message ?? "see the log"}`,
      "Read the prints of the reward function in the log below, and correct it.",
      mendLink(`reward_function.py ${errors.errors.at(-1)?.message ?? ""}`),
    ],
    errors?.discarded && [
      "warn",
      `The reward function discarded ${number(errors.discarded)} episodes.`,
    ],
    run.budget?.damaged && [
      "warn",
      "Some files of the daily budget cannot be read, so hours may be missing.",
    ],
    convergence?.reached && [
      "good",
      `Training (${number(convergence.training)} %) and evaluations (${number(convergence.evaluation)} %) have converged: there is little left to learn here.`,
      "Stop, or go on with a harder track or reward.",
    ],
    ...(run.milestones ?? []).map((each) => [
      "good",
      `Milestone ${each.word}: ${each.checkpoint.replace(".ckpt", "")}, ${number(each.laps)} of ${number(each.episodes)} evaluation laps clean, best ${number(each.best_lap_s, 2, "s")}.`,
    ]),
  ].filter(Boolean);
}

function Said({ list }) {
  if (!list.length) return null;
  return html`<div class="live-said"><ul>${list.map(
    ([kind, text, remedy, link]) => html`<li key=${text}>
      <span class=${`dot ${kind}`}></span><${Prose} text=${text} />
      ${remedy && html`<span class="remedy"> <${Prose} text=${remedy} /></span>`}
      ${link && html` <a href=${link.href}>${link.text}</a>`}
    </li>`,
  )}</ul></div>`;
}
