// The newest lines of a log: trainer, workers, what the reward function prints. It can be paused.

import { fill, h, number } from "/dom.js";
import { follow } from "/socket.js";

const MOST_LINES = 300;

/** @param cards tells the names of the workers that there are. */
export function logPanel(runId, signal, cards) {
  const which = h("select", { id: "live-log-name", change: open });
  const pause = h(
    "button",
    {
      type: "button",
      "aria-pressed": "false",
      click: () => {
        paused = !paused;
        pause.setAttribute("aria-pressed", String(paused));
        pause.textContent = paused ? "Go on" : "Pause";
        draw();
      },
    },
    "Pause",
  );
  const lines = h("pre", {
    class: "live-log",
    tabindex: "0",
    role: "log",
    "aria-live": "off",
    "aria-labelledby": "live-log",
  });
  const note = h("p", { class: "quiet", role: "status" }, " ");
  let own = null,
    list = [],
    paused = false,
    kept = 0,
    shown = "";

  function open() {
    own?.abort();
    own = new AbortController();
    signal.addEventListener("abort", () => own.abort(), { once: true });
    list = [];
    kept = 0;
    note.textContent = " ";
    fill(lines);
    follow(
      `log:${runId}:${which.value}`,
      (data) => {
        if (data.error) {
          note.textContent = `${data.error.message} ${data.error.remedy ?? ""}`;
          return;
        }
        if (data.anew) {
          list = [];
          if (!paused) kept = 0;
        }
        list = list.concat(data.lines).slice(-MOST_LINES);
        if (paused) kept += data.lines.length;
        note.dataset.text = data.note;
        draw();
      },
      own.signal,
    );
  }

  function draw() {
    const text =
      note.dataset.text ||
      (paused ? `Paused. ${number(kept)} new ${kept === 1 ? "line" : "lines"} since.` : " ");
    if (note.textContent !== text) note.textContent = text;
    if (paused) return;
    kept = 0;
    const end = lines.scrollHeight - lines.scrollTop - lines.clientHeight < 40;
    const content = list.join("\n");
    if (content === shown && lines.textContent === content) return;
    shown = lines.textContent = content;
    if (end) lines.scrollTop = lines.scrollHeight;
  }

  function names(workers) {
    const simulations = workers.filter((name) => name.startsWith("sim-")),
      numbers = simulations.length ? simulations.map((name) => name.slice(4)) : ["0"];
    const wanted = [
      ["trainer", "Trainer"],
      ...numbers.map((each) => [`sim-${each}`, `Worker sim-${each}`]),
      ...numbers.map((each) => [`reward-${each}`, `Prints of the reward function in sim-${each}`]),
      ["evaluation", "Evaluation"],
      ["supervisor", "Supervisor"],
    ];
    const before = which.value;
    fill(
      which,
      wanted.map(([value, text]) => h("option", { value }, text)),
    );
    which.value = wanted.some(([value]) => value === before) ? before : "trainer";
    if (which.value !== before) open();
  }
  cards.onNames(names);
  return h(
    "section",
    { "aria-labelledby": "live-log" },
    h("h2", { id: "live-log" }, "Log"),
    h("p", { class: "actions" }, h("label", { for: "live-log-name" }, "Of "), which, pause),
    lines,
    note,
  );
}
