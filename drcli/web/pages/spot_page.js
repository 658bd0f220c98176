// Trainings on spot machines of Amazon: what runs and costs money now, its log, start, stop and delete.

import { get } from "/api.js";
import { ask, confirmed } from "/ask.js";
import { runTask } from "/model_tasks.js";
import { notify } from "/notices.js";
import { Act, useGet } from "/store.js";
import { capital, moment, number } from "/text.js";
import { Button, Choice, Columns, Empty, Failure, Folded, Loaded, Tiles } from "/ui.js";
import { html, useEffect, useRef, useState } from "/vendor/preact/preact.js";

export const title = "Spot machines";

const EVERY_MS = 30_000;
/** @type {[string, (machine: any) => any][]} */
const MACHINE = [
  ["Type", ({ type }) => type],
  ["Zone", ({ zone }) => zone],
  ["State", ({ state, said }) => [state, said].filter(Boolean).join(", ")],
  ["Since", ({ started }) => moment(started)],
  ["USD an hour", ({ usd_per_hour: price }) => (price ? number(price, 3) : null)],
];
const usd = (value, digits) => number(value, digits, "USD");
const path = (name, stack, more = "") =>
  `/api/spot/${name}?stack=${encodeURIComponent(stack)}${more}`;
const running = (stack) => stack.machines.filter((each) => !each.ended);
const hourly = (stack) => running(stack).reduce((sum, each) => sum + each.usd_per_hour, 0);
/** What machines cost now, in a sentence. */
function costText(stacks) {
  const now = stacks.flatMap(running);
  if (!now.length) return "No machine costs money now.";
  const all = `${now.length} ${now.length === 1 ? "machine runs" : "machines run"}`;
  const known = now.filter((each) => each.usd_per_hour).length;
  if (!known) return `${all}; the price is not known yet.`;
  const sum = stacks.reduce((total, each) => total + hourly(each), 0);
  return `${all} for ${known < now.length ? "at least " : ""}${usd(sum, 3)} an hour.`;
}

export function Page() {
  const { value, error, reload } = useGet("/api/spot");
  const good = useRef(null);
  if (value) good.current = value;
  const found = good.current;
  useEffect(() => {
    const timer = setInterval(() => document.hidden || reload(), EVERY_MS);
    return () => clearInterval(timer);
  }, []);
  const act = async (name, body) => {
    const result = await runTask(`/api/spot/${name}`, body).finally(reload);
    if (typeof result === "string") notify(result);
    return result;
  };
  const given = useRef({});
  const start = async () => {
    const send = (values) => {
      given.current = values;
      return act("plan", values);
    };
    const fields = found.start.fields.map((each) => ({
      ...each,
      value: given.current[each.name] ?? each.value,
    }));
    const plan = await ask({ ...found.start, fields, send });
    if (!plan || !(await agreed(plan))) return;
    await act("create", { ...given.current, agreed_usd_per_hour: plan.most_usd_per_hour });
    given.current = {};
  };
  const makeBucket = async () => {
    const given = await ask(found.base);
    if (given) await act("base", given);
  };
  if (!found)
    return html`<h1>Spot machines</h1>${error ? html`<${Failure} error=${error} /><${Missing} />` : html`<p class="quiet">Asking Amazon …</p>`}`;
  const { stacks } = found;
  const hasBucket = found.bucket || stacks.some((each) => each.kind === "base");
  return html`
    <h1>Spot machines</h1>
    <p>Train the model of this folder on a machine of Amazon in ${found.region}. When the machine is taken away, the next one continues; when the training ends, so does the machine.</p>
    <p role="status"><strong>${costText(stacks)}</strong></p>
    <p class="actions">
      <${Act} class=${hasBucket && "main"} disabled=${!hasBucket} action=${start} text="Start a spot training" />
      <${Act} class=${hasBucket ? null : "main"} action=${makeBucket} text="Make a bucket" />
      <${Button} onClick=${reload}>Look again<//>
    </p>
    ${error && html`<${Failure} error=${error} />`}
    ${!hasBucket && html`<${Empty} text="A spot training needs a bucket at Amazon for its model. Make one first." />`}
    ${hasBucket && !stacks.length && html`<${Empty} text=${`Nothing was started in ${found.region}.`} />`}
    ${stacks.map((stack) => html`<${Stack} key=${stack.stack} stack=${stack} act=${act} />`)}`;
}

const Missing = () => html`
  <p>Spot machines need an account at Amazon and its access keys on this machine: run <code>aws configure</code>. With DR_CLOUD=aws, <a href="#/settings">Settings</a> has the profile (DR_LOCAL_S3_PROFILE); the region is DR_AWS_APP_REGION.</p>`;

const agreed = ({ stack, most_usd_per_hour: most, extra_usd_per_hour: extra, said, notes }) => {
  const price =
    most === null ? "a price that is not known" : `up to ${usd(most + extra, 3)} an hour`;
  const detail = [...said, ...notes].map((line) => html`${line}<br />`);
  return confirmed(`Start ${stack} for ${price}?`, { action: "Start it", detail });
};

function Stack({ stack, act }) {
  const { stack: name, kind, machines } = stack;
  const training = kind === "training";
  const [showsLog, setShowsLog] = useState(false);
  const end = (about) => async () => {
    const values = await ask(await get(path("question", name, `&about=${about}`)));
    if (values) await act(about, { stack: name, ...values });
  };
  const figures = [
    ["Model", stack.model],
    ["Newest checkpoint", stack.checkpoint || "–"],
    ["Cost so far", stack.usd === null ? "–" : usd(stack.usd, 2)],
    ["Cost of an hour now", hourly(stack) ? usd(hourly(stack), 3) : "–"],
    ["Ends at the latest", moment(stack.ends)],
  ];
  return html`
    <section class="stack" aria-label=${name}>
      <h2>${name}</h2>
      <p>${training ? `${capital(stack.state)}.` : `The bucket ${stack.bucket} (${stack.state}).`} ${stack.reason}</p>
      ${training && html`<${Tiles} values=${figures} />`}
      ${machines.length > 0 && html`<${Columns} caption=${`Machines of ${name}`} columns=${MACHINE} rows=${machines} />`}
      <p class="actions">
        ${training && html`<${Act} action=${end("stop")} text="Stop and save" />`}
        <${Act} class="danger" action=${end("delete")} text="Delete" />
      </p>
      ${training && html`<${Folded} title="Log" open=${showsLog} onToggle=${setShowsLog}><${Log} stack=${name} /><//>`}
    </section>`;
}

function Log({ stack }) {
  const [chosen, setChosen] = useState("");
  const found = useGet(path("logs", stack, chosen && `&log=${encodeURIComponent(chosen)}`));
  return html`
    <${Loaded} found=${found} reading="Reading the bucket …">${({ logs, log, lines }) => html`
      <div class="actions">
        <${Choice} label="Log" options=${logs} value=${log} onChange=${setChosen} />
        <${Button} onClick=${found.reload}>Read again<//>
      </div>
      <pre class="file-text" tabindex="0" role="log" aria-live="off" aria-label=${`Log of ${stack}`}>${lines.join("\n")}</pre>`}<//>`;
}
