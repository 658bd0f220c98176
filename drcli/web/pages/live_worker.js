// The card of one worker: camera, view from behind, map with all cars, figures, actions.

import { get, post } from "/api.js";
import { andResets, duration, fill, h, lapTime, notify, number, tiles } from "/dom.js";
import { actionBars } from "/live_actions.js";
import { livePicture } from "/live_picture.js";
import { follow } from "/socket.js";
import { trackMap } from "/track_map.js";

const TRAIL_POINTS = 400;
const STATUS = {
  in_progress: "drives",
  lap_complete: "lap complete",
  off_track: "off track",
  crashed: "crashed",
  reversed: "wrong direction",
  immobilized: "stuck",
  time_up: "time is up",
  stopped: "stopped",
};
const tracks = new Map();

/** The lines of a track, read once. */
function track(world) {
  if (!tracks.has(world))
    tracks.set(
      world,
      get(`/api/track?world=${encodeURIComponent(world)}`).catch((error) => {
        tracks.delete(world);
        throw error;
      }),
    );
  return tracks.get(world);
}

const statusText = (status) => STATUS[status] ?? String(status).replaceAll("_", " ");
const rgb = (values) => (values?.length === 3 ? `rgb(${values.join(",")})` : "c1");

export function workerCard(runId, name, signal) {
  const own = new AbortController();
  signal.addEventListener("abort", () => own.abort(), { once: true });
  const evaluation = name.startsWith("evaluation");
  const heading = `live-${name}`;
  const does = h("p", { class: "live-does", role: "status" }, " "),
    hint = h("p", { class: "live-hint quiet" }, " ");
  const car = h(
    "select",
    { id: `${heading}-car`, change: chooseCar },
    h("option", { value: "" }, "the one that has come furthest"),
  );
  const carRow = h("p", { class: "live-car" }, h("label", { for: `${heading}-car` }, "Car "), car);
  // What is evaluated comes with the first scene; the digits of the name say when it began.
  const title = h("h3", { id: heading }, evaluation ? "Evaluation" : name);
  const camera = livePicture("Camera", `What the car of ${name} sees`, [160, 120]);
  const chase = livePicture("View from behind", `The car of ${name} from behind`, [320, 240]);
  const pictures = h("div", { class: "live-views" }, camera.element, chase.element);
  const map = trackMap(
    { label: `Map of the track with the cars of ${name}`, height: 240 },
    own.signal,
  );
  const legend = h("p", { class: "live-legend quiet" }, " ");
  const [figures, setFigures] = tiles([
    "Speed",
    "Steering",
    "Progress",
    "Reward of the step",
    "Reward so far",
    "Lap time",
  ]);
  figures.classList.add("live-figures");
  const bars = actionBars();
  const finished = h("ol", { class: "live-finished" });
  const details = h(
    "div",
    { class: "live-details" },
    bars.element,
    h("div", {}, h("h4", {}, "Last episodes"), finished),
  );
  const element = h(
    "article",
    { class: "live-card", "aria-labelledby": heading, "data-worker": name },
    h("div", { class: "live-card-head" }, title, carRow),
    does,
    hint,
    h(
      "div",
      { class: "live-body" },
      pictures,
      h("div", { class: "live-map" }, map.element, legend),
      figures,
      details,
    ),
  );

  let facts = null,
    world = null,
    visible = false,
    watching = null,
    laps = null,
    cars = 0,
    serial = 0,
    trails = new Map(),
    lastTrails = 0,
    colors = ["c1"];

  const seen = new IntersectionObserver(
    (entries) => {
      visible = entries.at(-1).isIntersecting;
      watch();
    },
    { rootMargin: "80px" },
  );
  seen.observe(element);
  document.addEventListener("visibilitychange", watch, { signal: own.signal });
  own.signal.addEventListener(
    "abort",
    () => {
      seen.disconnect();
      watching?.abort();
    },
    { once: true },
  );

  /** Watch pictures only while they can be seen. */
  function watch() {
    const wanted = visible && !document.hidden && facts !== null && !own.signal.aborted;
    const mode = wanted ? facts.place : "";
    if ((watching?.mode ?? "") === mode) return;
    watching?.abort();
    watching = null;
    if (!mode) return;
    watching = Object.assign(new AbortController(), { mode });
    const topic = `live:${runId}:${name}`;
    if (mode === "live") {
      follow(`${topic}:state`, takeState, watching.signal);
      follow(`${topic}:scene`, takeScene, watching.signal);
      follow(`${topic}:camera`, camera.show, watching.signal);
      follow(`${topic}:chase`, chase.show, watching.signal);
    }
    const number = /^sim-(\d+)$/.exec(name);
    if (number) follow(`laps:${runId}:${number[1]}`, takeLaps, watching.signal);
  }

  async function chooseCar() {
    const chosen = car.value === "" ? null : Number(car.value);
    try {
      await post("/api/live/car", { run_id: runId, worker: name, car: chosen }, own.signal);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
    }
  }

  function setCars(count) {
    if (count <= cars) return;
    for (; cars < count; cars += 1)
      car.append(h("option", { value: String(cars) }, String(cars + 1)));
    if (facts?.car !== null && facts?.car !== undefined) car.value = String(facts.car);
  }

  async function setWorld(value) {
    if (!value || value === world) return;
    world = value;
    trails.clear();
    try {
      const lines = await track(value);
      if (world === value) map.setTrack(lines);
    } catch (error) {
      if (world === value) {
        world = null;
        legend.textContent = `There is no map: ${error.message}`;
      }
    }
  }

  function takeState(data) {
    if (data.gone) {
      does.textContent =
        "The connection to the worker was lost. The page connects again by itself.";
      return;
    }
    const { state } = data;
    if (!state) return;
    const age = Date.now() / 1000 - state.since_s;
    does.textContent =
      `${state.activity}${state.waits && age > 1 ? `, for ${duration(age)}` : ""}.`.replace(
        /^./,
        (letter) => letter.toUpperCase(),
      );
    does.classList.toggle("waits", state.waits);
    if (hint.textContent !== state.hint) hint.textContent = state.hint || " ";
  }

  function takeScene({ scene }) {
    if (!scene) return;
    setWorld(scene.world);
    if (evaluation) {
      const text = `${scene.racers.length > 1 ? "Race of" : "Evaluation of"} ${scene.racers.map((racer) => racer.model).join(" and ")}`;
      if (title.textContent !== text) title.textContent = text;
    }
    setCars(Math.max(0, ...scene.cars.map((each) => each.car + 1)));
    const cars = scene.cars.filter((each) => !each.world || each.world === scene.world);
    const many = scene.racers.length > 1,
      shown = cars.find((each) => each.car === scene.shown?.car);
    colors = scene.racers.map((racer) => rgb(racer.rgb));
    const colorOf = (each) =>
      many ? (colors[each.racer] ?? "c1") : each.phase === "evaluation" ? "c2" : "c1";
    const order = shown ? [shown, ...cars.filter((each) => each !== shown)] : cars;
    map.setCars(
      order.map((each) => ({
        x: each.x,
        y: each.y,
        yaw: (each.yaw_deg * Math.PI) / 180,
        color: colorOf(each),
        name: many ? scene.racers[each.racer].model : each === shown ? `car ${each.car + 1}` : "",
      })),
    );
    map.setObjects(
      (scene.shown?.objects ?? []).map((each) => [each.x, each.y, (each.yaw_deg * Math.PI) / 180]),
    );
    legend.textContent = many
      ? scene.racers.map((racer) => `${racer.model}: ${racer.color}`).join(", ")
      : `${number(cars.length)} ${cars.length === 1 ? "car" : "cars"}, ${scene.world}${scene.reverse ? ", reversed" : ""}${scene.checkpoint ? `, ${scene.checkpoint.replace(".ckpt", "")}` : ""}. ${evaluation ? "" : laps?.iteration !== null && laps ? `Lines: iteration ${laps.iteration}, green where the lap was completed.` : ""}`;
    setFigures(
      shown
        ? [
            `${number(shown.speed_mps, 2)} m/s, asked ${number(shown.asked_mps, 2)}`,
            `${number(Math.abs(shown.steering_deg), 0)}° ${Math.abs(shown.steering_deg) < 0.5 ? "straight" : shown.steering_deg > 0 ? "left" : "right"}`,
            `${number(shown.progress, 1)} %${shown.laps ? `, lap ${shown.laps + 1}` : ""}`,
            number(shown.reward, 3),
            `${number(shown.total, 1)} in ${number(shown.steps)} steps`,
            `${lapTime(shown.lap_s)}${andResets(shown.resets)}`,
          ]
        : ["–", "–", "–", "–", "–", "–"],
    );
    bars.update(scene.actions, scene.shown);
    if (evaluation) trail(cars, colorOf);
    const last = scene.finished.at(-1);
    if (last && last.serial !== serial) {
      serial = last.serial;
      fill(
        finished,
        scene.finished
          .slice(-5)
          .reverse()
          .map((each) =>
            h(
              "li",
              {},
              `${each.phase === "evaluation" ? "Evaluation" : "Training"} ${number(each.episode)}: ${each.progress >= 100 && !each.resets ? "clean lap" : statusText(each.status)}${andResets(each.resets)}, ${number(each.progress, 0, "%")}, ${number(each.time_s, 2, "s")}, reward ${number(each.reward, 1)}`,
            ),
          ),
      );
    }
  }

  /** Lines of an evaluation as they come: its trace is written at its end. */
  function trail(list, colorOf) {
    for (const each of list) {
      const key = `${each.car}.${each.episode}.${each.laps}`;
      if (!trails.has(key)) {
        trails.set(key, { x: [], y: [], color: colorOf(each) });
        for (const old of [...trails.keys()].slice(0, -8)) trails.delete(old);
      }
      const line = trails.get(key);
      line.x.push(each.x);
      line.y.push(each.y);
      if (line.x.length > TRAIL_POINTS) {
        line.x.shift();
        line.y.shift();
      }
    }
    if (performance.now() - lastTrails < 500) return;
    lastTrails = performance.now();
    const all = [...trails.values()].reverse();
    map.setPaths(all.map((line, k) => ({ ...line, alpha: Math.max(0.15, 0.9 - 0.12 * k) })));
  }

  function takeLaps(value) {
    if (value.error) {
      hint.textContent = `${value.error.message} The lines on the map are older.`;
      return;
    }
    laps = value;
    const lines = [...value.lines].reverse(),
      step = 0.65 / Math.max(lines.length, 1);
    map.setPaths(
      lines.map((line, k) => ({
        x: line.x,
        y: line.y,
        color: line.progress >= 100 ? "c3" : "faint",
        alpha: Math.max(0.12, 0.8 - step * k),
      })),
    );
    if (facts?.place === "bucket")
      legend.textContent =
        value.iteration === null
          ? "The first iteration has not been finished yet."
          : `Lines: iteration ${value.iteration}, the newest in the bucket; green where the lap was completed.`;
  }

  return {
    element,
    close() {
      own.abort();
    },
    update(value) {
      const before = facts?.place;
      facts = value;
      element.dataset.place = value.place;
      setWorld(world ?? value.world);
      const live = value.place === "live";
      if (before !== value.place) {
        for (const part of [pictures, carRow, figures, details])
          part.hidden = value.place === "bucket";
        hint.textContent = " ";
        if (!live) {
          map.setCars([]);
          map.setObjects([]);
        }
        for (const picture of [camera, chase])
          picture.wait(live ? "Waiting for the first picture." : "No picture.");
      }
      if (value.place === "bucket") {
        does.textContent = `${value.activity}.`.replace(/^./, (letter) => letter.toUpperCase());
        hint.textContent = `Runs on ${value.host}. Live pictures are shown on that machine only; the map shows the last finished iteration.`;
      } else if (!live) {
        does.textContent = `${value.activity || "starts"}.`.replace(/^./, (letter) =>
          letter.toUpperCase(),
        );
        const starts = value.restarts
          ? `it was started again (${number(value.restarts)} times by now)`
          : "it is just starting";
        hint.textContent = value.alive
          ? `It shows no live pictures: ${starts}, or DR_LIVE_VIEW is off.`
          : "It has ended before its time. Its pictures come back when it is started again.";
      }
      const chosen = value.car === null || value.car === undefined ? "" : String(value.car);
      if (live && car.value !== chosen && document.activeElement !== car) {
        setCars(Number(chosen || -1) + 1);
        car.value = chosen;
      }
      watch();
    },
  };
}
