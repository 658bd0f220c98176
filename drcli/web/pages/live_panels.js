// The parts of the live page that are folded: machine, cost and requests; and the log.

import { useTopic } from "/store.js";
import { follow } from "/socket.js";
import { bytes, number } from "/text.js";
import { Choice, Failure, Tiles, html, useEffect, useLayoutEffect, useRef, useState } from "/ui.js";

const MOST_LINES = 300;

const Meter = ({ name, text, share }) => html`
  <div>
    <dt>${name}</dt><dd>${text}</dd>
    <span class="live-meter" aria-hidden="true">
      <span class=${`live-meter-fill${share > 0.92 ? " full" : ""}`}
        style=${{ transform: `scaleX(${Math.min(1, Math.max(0, share ?? 0))})` }}></span>
    </span>
  </div>`;

/** Processor, memory, graphics processors and disk of the machine of the console; what the training costs. */
export function MachinePanel({ run, elsewhere }) {
  const { value: now, error } = useTopic("machine");
  const { spending, requests } = run ?? {};
  const used = (part, whole) => ({
    text: `${bytes(part)} of ${bytes(whole)}`,
    share: part / whole,
  });
  const cost = spending
    ? `${spending.usd === null ? "no price set" : number(spending.usd, 2, "USD")}, ${number(spending.hours, 2, "h")}`
    : "–";
  const asked =
    requests?.hours >= 0.1
      ? `${number((requests.puts + requests.gets) / requests.hours)} an hour`
      : "–";
  return html`
    ${error && html`<${Failure} error=${error} />`}
    ${
      now &&
      html`<p class="quiet">${now.name || "Processor"}, ${number(now.cores)} cores${now.load === null ? "" : `, load ${number(now.load, 1)}`}</p>
      <dl class="tiles">
        <${Meter} name="Processor" text=${number(now.processor_percent, 0, "%")} share=${now.processor_percent / 100} />
        <${Meter} name="Memory" ...${used(now.memory_used_bytes, now.memory_bytes)} />
        <${Meter} name="Disk of the folder" ...${used(now.disk_used_bytes, now.disk_bytes)} />
        ${now.gpus.map(
          (
            gpu,
            k,
          ) => html`<${Meter} key=${k} name=${gpu.name || `GPU ${k}`} share=${(gpu.percent ?? 0) / 100}
          text=${`${number(gpu.percent, 0, "%")}, ${bytes(gpu.memory_used_bytes)} of ${bytes(gpu.memory_bytes)}`} />`,
        )}
      </dl>`
    }
    <${Tiles} values=${[
      ["Cost", cost],
      ["Requests to the bucket", asked],
    ]} />
    <${OtherWorkers} workers=${run && (run.state === "running" || run.state === "starting") ? run.workers : elsewhere?.host ? elsewhere.workers : []} />`;
}

/** What the workers do that do not drive. */
const OtherWorkers = ({ workers }) =>
  html`<p class="quiet">${workers
    .filter(({ name }) => name !== "supervisor" && !name.startsWith("sim-"))
    .map(
      ({ name, alive, activity, health }) =>
        `${name} ${alive === false ? "does not run" : activity}${health ? ` (${number(health.memory_mb)} MB)` : ""}. `,
    )}</p>`;

/** The newest lines of a log: trainer, workers, what the reward function prints. It can be paused. */
export function LogPanel({ runId, workers }) {
  const [name, setName] = useState("trainer");
  const [lines, setLines] = useState([]);
  const [note, setNote] = useState("");
  const [paused, setPaused] = useState(null); // the number of lines when it was paused
  const count = useRef(0);
  const place = useRef(null);
  useEffect(() => {
    const own = new AbortController();
    setLines([]);
    follow(
      `log:${runId}:${name}`,
      (data) => {
        if (data.error) {
          setNote(`${data.error.message} ${data.error.remedy ?? ""}`);
          return;
        }
        count.current += data.lines.length;
        setLines((before) => (data.anew ? [] : before).concat(data.lines).slice(-MOST_LINES));
        setNote(data.note);
      },
      own.signal,
    );
    return () => own.abort();
  }, [runId, name]);
  const kept = useRef([]);
  if (paused === null) kept.current = lines;
  const text = kept.current.join("\n");
  useLayoutEffect(() => {
    const { current } = place;
    // Who reads further up stays there.
    if (current.scrollHeight - current.scrollTop - current.clientHeight < 100)
      current.scrollTop = current.scrollHeight;
  }, [text]);
  const fresh = paused === null ? 0 : count.current - paused;
  const numbers = workers.filter((each) => each.startsWith("sim-")).map((each) => each.slice(4));
  const options = [
    ["trainer", "Trainer"],
    ...(numbers.length ? numbers : ["0"]).flatMap((each) => [
      [`sim-${each}`, `Worker sim-${each}`],
      [`reward-${each}`, `Prints of the reward function in sim-${each}`],
    ]),
    ["evaluation", "Evaluation"],
    ["supervisor", "Supervisor"],
  ];
  return html`
    <section aria-labelledby="live-log">
      <h2 id="live-log">Log</h2>
      <div class="actions">
        <${Choice} label="Of" value=${name} options=${options} onChange=${setName} />
        <button type="button" aria-pressed=${String(paused !== null)} onClick=${() => setPaused(paused === null ? count.current : null)}>
          ${paused === null ? "Pause" : "Go on"}
        </button>
      </div>
      <pre class="live-log" tabindex="0" role="log" aria-live="off" aria-labelledby="live-log" ref=${place}>${text}</pre>
      <p class="quiet" role="status">${note || (paused === null ? "" : `Paused. ${number(fresh)} new ${fresh === 1 ? "line" : "lines"} since.`)}</p>
    </section>`;
}
