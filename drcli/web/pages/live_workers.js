// A card for each simulation worker and evaluation of a run, wherever it runs; and who waits for whom.

import { duration, empty, fill, h, number } from "/dom.js";
import { workerCard } from "/live_worker.js";

/** The element, and functions that take what is known. */
export function workerCards(runId, signal) {
  const list = h("div", { class: "live-cards" });
  const others = h("p", { class: "live-others quiet", role: "status" }, " ");
  const note = h("div", {});
  const element = h(
    "section",
    { "aria-labelledby": "live-workers" },
    h("h2", { id: "live-workers" }, "Workers"),
    others,
    note,
    list,
  );
  const cards = new Map(),
    listeners = new Set();
  let run = null,
    present = null,
    elsewhere = null,
    names = "";

  /** Where each worker of the run can be seen: live here, here but not live, or in the bucket only. */
  function known() {
    const found = new Map();
    for (const worker of elsewhere?.host ? elsewhere.workers : [])
      if (worker.name.startsWith("sim-"))
        found.set(worker.name, {
          place: "bucket",
          activity: worker.activity,
          host: worker.host,
          world: elsewhere.world,
        });
    if (run && (run.state === "running" || run.state === "starting")) {
      for (const worker of run.workers)
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
            memory: worker.health?.memory_mb,
          });
    }
    for (const worker of present?.workers ?? []) {
      if (worker.run_id !== runId) continue;
      const before = found.get(worker.worker);
      found.set(worker.worker, {
        world: null,
        activity: "",
        ...before,
        place: "live",
        car: worker.car,
      });
    }
    return found;
  }

  function draw() {
    const found = known();
    for (const [name, card] of cards) {
      if (!found.has(name)) {
        card.close();
        card.element.remove();
        cards.delete(name);
      }
    }
    for (const name of [...found.keys()].sort((a, b) =>
      a.localeCompare(b, "en", { numeric: true }),
    )) {
      if (!cards.has(name)) {
        const card = workerCard(runId, name, signal);
        cards.set(name, card);
        const after = [...list.children].find(
          (each) => each.dataset.worker.localeCompare(name, "en", { numeric: true }) > 0,
        );
        list.insertBefore(card.element, after ?? null);
      }
      cards.get(name).update(found.get(name));
    }
    const all = [...found.keys()].join(" ");
    if (all !== names) {
      names = all;
      listeners.forEach((each) => each([...found.keys()]));
    }
    tell(found);
  }

  function tell(found) {
    const lines = [];
    const active = run && (run.state === "running" || run.state === "starting");
    for (const worker of active ? run.workers : elsewhere?.host ? elsewhere.workers : []) {
      if (worker.name === "supervisor" || worker.name.startsWith("sim-")) continue;
      const health = worker.health;
      lines.push(
        `${worker.name} ${worker.alive === false ? "does not run" : worker.activity}${health ? ` (${number(health.memory_mb)} MB${health.progress_age_s !== null ? `, last gradient step ${duration(health.progress_age_s)} ago` : ""})` : ""}.`,
      );
    }
    others.textContent = lines.join(" ") || " ";
    if (found.size || !run) {
      if (note.firstChild && found.size) fill(note);
      return;
    }
    const text = active
      ? "The simulation workers are starting."
      : "No worker runs now. Cameras and maps appear here as soon as a training or an evaluation starts.";
    if (note.textContent !== text) fill(note, empty(text));
  }

  return {
    element,
    setRun(value) {
      run = value;
      draw();
    },
    setPresent(value) {
      present = value;
      draw();
    },
    setElsewhere(value) {
      elsewhere = value;
      draw();
    },
    /** Hear of the names of the workers. */
    onNames(listener) {
      listeners.add(listener);
      listener(names ? names.split(" ") : []);
    },
  };
}
