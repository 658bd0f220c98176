// The parts of the live page that are folded: machine, cost and requests; and the log.

import { useTopic } from "/store.js";
import { follow } from "/socket.js";
import { number } from "/text.js";
import { Choice, Failure, Tiles, html, useEffect, useLayoutEffect, useRef, useState } from "/ui.js";

const MOST_LINES = 300;

const Meter = ({ name, text, share }) => html`
  <div>
    <dt>${name}</dt><dd>${text}</dd>
    <span class="live-meter" aria-hidden="true">
      <span class=${`live-meter-fill${share > 0.92 ? " full" : ""}`}
        style=${{ transform: `scaleX(${Math.min(1, Math.max(0, share))})` }}></span>
    </span>
  </div>`;

/** Processor, memory, graphics processors and disk of the machine of the console; what the training costs. */
export function MachinePanel({ words, others }) {
  const { value: machine, error } = useTopic("machine");
  return html`
    ${error && html`<${Failure} error=${error} />`}
    ${
      machine &&
      html`<p class="quiet">${machine.text}</p>
      <dl class="tiles">${machine.meters.map(([name, text, share]) => html`<${Meter} key=${name} name=${name} text=${text} share=${share} />`)}</dl>`
    }
    ${words && html`<${Tiles} values=${words.spent} /><p class="quiet">${words.others || others}</p>`}`;
}

/** The newest lines of a log: trainer, workers, what the reward function prints. It can be paused. */
export function LogPanel({ runId, workers }) {
  const [name, setName] = useState("trainer");
  const [log, setLog] = useState({ lines: [], count: 0, note: "" });
  const [paused, setPaused] = useState(null); // the log as it was then
  const place = useRef(null);
  useEffect(() => {
    const own = new AbortController();
    setLog({ lines: [], count: 0, note: "" });
    setPaused(null);
    follow(
      `log:${runId}:${name}`,
      ({ error, anew, lines, note }) =>
        setLog((before) =>
          error
            ? { ...before, note: `${error.message} ${error.remedy ?? ""}` }
            : {
                lines: (anew ? lines : before.lines.concat(lines)).slice(-MOST_LINES),
                count: before.count + lines.length,
                note,
              },
        ),
      own.signal,
    );
    return () => own.abort();
  }, [runId, name]);
  const text = (paused ?? log).lines.join("\n");
  useLayoutEffect(() => {
    const { current } = place;
    // Who reads further up stays there.
    if (current.scrollHeight - current.scrollTop - current.clientHeight < 100)
      current.scrollTop = current.scrollHeight;
  }, [text]);
  const fresh = paused && log.count - paused.count;
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
        <button type="button" aria-pressed=${String(paused !== null)} onClick=${() => setPaused(paused ? null : log)}>
          ${paused ? "Go on" : "Pause"}
        </button>
      </div>
      <pre class="live-log" tabindex="0" role="log" aria-live="off" aria-labelledby="live-log" ref=${place}>${text}</pre>
      <p class="quiet" role="status">${log.note || (paused && `Paused. ${number(fresh)} new ${fresh === 1 ? "line" : "lines"} since.`)}</p>
    </section>`;
}
