// Trainings on spot machines of Amazon: what runs and costs money now, its log, start, stop and delete.

import { get } from "/api.js";
import { ask } from "/ask.js";
import { confirmed } from "/dialogs.js";
import { useDraft } from "/drafts.js";
import { runTask } from "/model_tasks.js";
import { notify } from "/notices.js";
import { useAction, useGet } from "/store.js";
import { capital, moment, number } from "/text.js";
import {
  Button,
  Choice,
  Empty,
  Failure,
  Table,
  Tiles,
  html,
  useEffect,
  useRef,
  useState,
} from "/ui.js";

export const title = "Spot machines";

const EVERY_MS = 30_000;
const MARKETS = [
  ["spot", "A spot machine: cheaper, may be taken away"],
  ["spot-or-on-demand", "A spot machine, or an ordinary one while there is none"],
  ["on-demand", "An ordinary machine"],
];
const HOURS = [
  ...["2", "4", "8", "12", "24", "48"].map((hours) => [hours, `${hours} hours`]),
  ["0", "No limit: until the training ends"],
];
const usd = (value, digits) => number(value, digits, "USD");
const path = (name, stack, more = "") =>
  `/api/spot/${name}?stack=${encodeURIComponent(stack)}${more}`;
const running = (stack) => stack.machines.filter((each) => !each.ended);
const hourly = (stack) => running(stack).reduce((sum, each) => sum + each.usd_per_hour, 0);
/** What machines cost now, in a sentence. */
function costText(stacks) {
  const now = stacks.flatMap(running);
  const unknown = now.filter((each) => !each.usd_per_hour).length;
  if (!now.length) return "No machine costs money now.";
  const all = `${now.length} ${now.length === 1 ? "machine runs" : "machines run"}`;
  if (unknown === now.length) return `${all}; the price is not known yet.`;
  const sum = usd(
    stacks.reduce((total, each) => total + hourly(each), 0),
    3,
  );
  return `${all} for ${unknown ? "at least " : ""}${sum} an hour.`;
}

export function Page() {
  const { value, error, reload } = useGet("/api/spot");
  const good = useRef(null);
  if (value) good.current = value;
  const found = good.current;
  const [log, setLog] = useState("");
  const draft = useDraft("spot", null);
  const values = { stack: "", place: null, market: "spot", hours: "12", ...draft.edits };
  useEffect(() => {
    const timer = setInterval(() => document.hidden || reload(), EVERY_MS);
    return () => clearInterval(timer);
  }, []);
  const act = async (name, body) => {
    const result = await runTask(`/api/spot/${name}`, body).finally(reload);
    if (typeof result === "string") notify(result);
    return result;
  };
  const [start, starting] = useAction(async () => {
    const given = await askWhat(found, values);
    if (!given) return;
    draft.set(given);
    const { stack, market } = given;
    const base = given.place.startsWith("base:") ? given.place.slice(5) : "";
    const body = { stack, market, base, ttl_minutes: 60 * Number(given.hours) };
    const plan = await act("plan", body);
    if (!(await agreed(plan))) return;
    await act("create", { ...body, agreed_usd_per_hour: plan.most_usd_per_hour });
    draft.set({});
  });
  const [makeBucket, making] = useAction(async () => {
    const given = await ask({
      title: "Make a bucket at Amazon",
      action: "Make it",
      intro: html`<p>Models of spot machines need a bucket in ${found.region}. Only what is stored in it costs money, about 0.023 USD for a GB a month.</p>`,
      fields: [{ name: "stack", label: "Name", value: "", more: { required: true } }],
    });
    if (given) await act("base", given);
  });
  if (!found)
    return html`<h1>Spot machines</h1>${error ? html`<${Failure} error=${error} /><${Missing} />` : html`<p class="quiet">Asking Amazon …</p>`}`;
  const { stacks } = found;
  const hasBucket = found.bucket || stacks.some((each) => each.kind === "base");
  return html`
    <h1>Spot machines</h1>
    <p>Train the model of this folder on a machine of Amazon in ${found.region}. When the machine is taken away, the next one continues; when the training ends, so does the machine.</p>
    <p role="status"><strong>${costText(stacks)}</strong></p>
    <p class="actions">
      <${Button} class=${hasBucket && "main"} busy=${starting || !hasBucket} onClick=${start}>Start a spot training<//>
      <${Button} class=${hasBucket ? null : "main"} busy=${making} onClick=${makeBucket}>Make a bucket<//>
      <${Button} onClick=${reload}>Look again<//>
    </p>
    ${error && html`<${Failure} error=${error} />`}
    ${!hasBucket && html`<${Empty} text="A spot training needs a bucket at Amazon for its model. Make one first." />`}
    ${hasBucket && !stacks.length && html`<${Empty} text=${`Nothing was started in ${found.region}.`} />`}
    ${stacks.map((stack) => html`<${Stack} key=${stack.stack} stack=${stack} act=${act} showsLog=${log === stack.stack} onLog=${() => setLog(log === stack.stack ? "" : stack.stack)} />`)}`;
}

const Missing = () => html`
  <p>Spot machines need an account at Amazon and its access keys on this machine: run <code>aws configure</code>. With DR_CLOUD=aws, <a href="#/settings">Settings</a> has the profile (DR_LOCAL_S3_PROFILE); the region is DR_AWS_APP_REGION.</p>`;

const askWhat = ({ stacks, bucket }, values) => {
  const places = [
    ...stacks
      .filter((each) => each.kind === "base")
      .map((each) => [`base:${each.stack}`, `${each.stack}: ${each.bucket}`]),
    ...(bucket ? [["", `${bucket}, of the settings`]] : []),
  ];
  return ask({
    title: "Start a spot training",
    action: "Ask for the price",
    intro: html`<p>Nothing is started yet: everything is checked, and the price is shown first.</p>`,
    fields: [
      {
        name: "stack",
        label: "Name",
        value: values.stack,
        help: "Of the training at Amazon: letters, digits and hyphens.",
        more: { required: true },
      },
      {
        name: "place",
        label: "Bucket of the model",
        value: values.place ?? places[0][0],
        options: places,
      },
      { name: "market", label: "Machine", value: values.market, options: MARKETS },
      { name: "hours", label: "Ends at the latest after", value: values.hours, options: HOURS },
    ],
  });
};

const agreed = (plan) => {
  const most = plan.most_usd_per_hour;
  const price =
    most === null
      ? "a price that is not known"
      : `up to ${usd(most + plan.extra_usd_per_hour, 3)} an hour`;
  return confirmed(`Start ${plan.stack} for ${price}?`, {
    action: "Start it",
    detail: [...plan.said, ...plan.notes].map((line) => html`${line}<br />`),
  });
};

function Stack({ stack, act, showsLog, onLog }) {
  const { stack: name, kind, machines } = stack;
  const training = kind === "training";
  const [stop, stopping] = useAction(async () => {
    const question = `Stop the training ${name}, and remove its machine?`;
    const detail =
      "It saves its model first, which stays in the bucket. This may take some minutes.";
    if (await confirmed(question, { action: "Stop it", detail }))
      await act("stop", { stack: name });
  });
  const [remove, removing] = useAction(async () => {
    const content = training ? "" : (await get(path("removal", name))).content;
    const lost = training
      ? "A training that runs loses what it has done since its last checkpoint; its model stays in the bucket."
      : content
        ? `${content} All of it is deleted with the bucket, and cannot be restored.`
        : "Its bucket does not exist any more.";
    const values = await ask({
      title: `Delete ${name}`,
      action: "Delete it",
      danger: true,
      intro: html`<p>${lost}</p>`,
      fields: [{ name: "confirm", label: `Type ${name} to confirm`, value: "" }],
      confirm: name,
    });
    if (values) await act("delete", { stack: name, ...values });
  });
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
      ${
        machines.length > 0 &&
        html`<${Table} caption=${`Machines of ${name}`} heads=${["Type", "Zone", "State", "Since", "USD an hour"]}
          rows=${machines.map((each) => [each.type, each.zone, `${each.state}${each.said && `, ${each.said}`}`, moment(each.started), each.usd_per_hour ? number(each.usd_per_hour, 3) : "–"])} />`
      }
      <p class="actions">
        ${training && html`<button type="button" aria-expanded=${String(showsLog)} onClick=${onLog}>Log</button><${Button} busy=${stopping} onClick=${stop}>Stop and save<//>`}
        <${Button} class="danger" busy=${removing} onClick=${remove}>Delete<//>
      </p>
      ${showsLog && html`<${Log} stack=${name} />`}
    </section>`;
}

function Log({ stack }) {
  const [chosen, setChosen] = useState("");
  const { value, error, reload } = useGet(
    path("logs", stack, chosen && `&log=${encodeURIComponent(chosen)}`),
  );
  if (error) return html`<${Failure} error=${error} />`;
  if (!value) return html`<p class="quiet">Reading the bucket …</p>`;
  return html`
    <div class="actions">
      <${Choice} label="Log" options=${value.logs} value=${value.log} onChange=${setChosen} />
      <${Button} onClick=${reload}>Read again<//>
    </div>
    <pre class="file-text" tabindex="0" role="log" aria-live="off" aria-label=${`Log of ${stack}`}>${value.lines.join("\n")}</pre>`;
}
