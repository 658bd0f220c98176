// One worker: camera, view from behind, map with all cars, figures, what the policy wants, last episodes.

import { post } from "/api.js";
import { LivePicture, addTrails, pageSeen, rgb, useTrack } from "/live_picture.js";
import { useAction, useTopic } from "/store.js";
import { andResets, capital, duration, lapTime, number } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Choice, Tiles, html, useMemo, useRef, useSeen, useState } from "/ui.js";

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
const WORDS_MS = 500; // numbers that change faster cannot be read
const MAP_MS = 100; // trails join places that are less than 0.6 m apart
const statusText = (status) => STATUS[status] ?? String(status).replaceAll("_", " ");

/** Probabilities of discrete actions as bars, or mean and spread; what the critic expects. */
function Policy({ actions, shown }) {
  const texts = [];
  if (shown?.mean)
    texts.push(
      `Steering ${number(shown.mean[0], 1)}° (${number(shown.low?.[0], 1)} to ${number(shown.high?.[0], 1)}), speed ${number(shown.mean[1], 2)} m/s (${number(shown.low?.[1], 2)} to ${number(shown.high?.[1], 2)}).`,
    );
  else if (shown && !shown.probabilities && actions.length)
    texts.push("The policy gives no probabilities now.");
  if (shown && (shown.value ?? null) !== null)
    texts.push(`The critic expects a return of ${number(shown.value, 2)} from here on.`);
  return html`
    <div>
      <h4>Actions</h4>
      <ul class="live-bars" tabindex="0" aria-label="Probabilities of the actions">
        ${actions.map(([steering, speed], k) => {
          const share = shown?.probabilities?.[k];
          return html`<li key=${k} class=${shown?.chosen === k ? "taken" : null}>
            <span>${number(steering, 0)}°, ${number(speed, 1)} m/s</span>
            <span class="live-bar-room"><span class="live-bar-fill" style=${{ transform: `scaleX(${share ?? 0})` }}></span></span>
            <span class="live-bar-share">${share === undefined ? "–" : number(100 * share, 0, "%")}</span>
          </li>`;
        })}
      </ul>
      <p class="quiet live-value">${texts.join(" ")}</p>
    </div>`;
}

const Finished = ({ episodes }) => html`
  <div>
    <h4>Last episodes</h4>
    <ol class="live-finished">
      ${episodes
        .slice(-5)
        .reverse()
        .map((each) => {
          const end = each.progress >= 100 && !each.resets ? "clean lap" : statusText(each.status);
          return html`<li key=${each.serial}>
          ${each.phase === "evaluation" ? "Evaluation" : "Training"} ${number(each.episode)}: ${end}${andResets(each.resets)}, ${number(each.progress, 0, "%")}, ${number(each.time_s, 2, "s")}, reward ${number(each.reward, 1)}
        </li>`;
        })}
    </ol>
  </div>`;

/** Lines of the newest iteration, the last one on top. */
function lapLines(laps) {
  const lines = [...laps.lines].reverse();
  const step = 0.65 / Math.max(lines.length, 1);
  return lines.map(({ x, y, progress }, k) => ({
    ...{ x, y, color: progress >= 100 ? "c3" : "faint", alpha: Math.max(0.12, 0.8 - step * k) },
  }));
}

function figuresOf(car) {
  const names = [
    "Speed",
    "Steering",
    "Progress",
    "Reward of the step",
    "Reward so far",
    "Lap time",
  ];
  if (!car) return names.map((name) => [name, "–"]);
  const angle = Math.abs(car.steering_deg);
  const side = angle < 0.5 ? "straight" : car.steering_deg > 0 ? "left" : "right";
  const values = [
    `${number(car.speed_mps, 2)} m/s, asked ${number(car.asked_mps, 2)}`,
    `${number(angle, 0)}° ${side}`,
    `${number(car.progress, 1)} %${car.laps ? `, lap ${car.laps + 1}` : ""}`,
    number(car.reward, 3),
    `${number(car.total, 1)} in ${number(car.steps)} steps`,
    `${lapTime(car.lap_s)}${andResets(car.resets)}`,
  ];
  return names.map((name, k) => [name, values[k]]);
}

/** What the worker does, and what there is to know about it, in two lines. */
function words({ place, activity, host, alive, restarts }, state) {
  if (state.gone)
    return ["The connection to the worker was lost. The page connects again by itself.", ""];
  if (place === "live") {
    const now = state.state;
    if (!now) return ["", ""];
    const age = Date.now() / 1000 - now.since_s;
    const does = capital(`${now.activity}${now.waits && age > 1 ? `, for ${duration(age)}` : ""}.`);
    return [does, now.hint];
  }
  if (place === "bucket")
    return [
      capital(`${activity}.`),
      `Runs on ${host}. Live pictures are shown on that machine only; the map shows the last finished iteration.`,
    ];
  const starts = restarts
    ? `it was started again (${number(restarts)} times by now)`
    : "it is just starting";
  return [
    capital(`${activity || "starts"}.`),
    alive
      ? `It shows no live pictures: ${starts}, or DR_LIVE_VIEW is off.`
      : "It has ended before its time. Its pictures come back when it is started again.",
  ];
}

const here = (scene) =>
  (scene?.cars ?? []).filter((each) => !each.world || each.world === scene.world);

/** The cars on the track: only this is drawn again for every scene. `lines` are those of the newest iteration. */
function LiveMap({ topic, name, evaluation, lines, track }) {
  const scene = useTopic(topic, MAP_MS).value?.scene ?? null;
  const trails = useRef(new Map());
  const cars = here(scene);
  const shown = cars.find((each) => each.car === scene.shown?.car);
  const racers = scene?.racers ?? [];
  const many = racers.length > 1;
  const colorOf = (each) =>
    many ? rgb(racers[each.racer]?.rgb) : each.phase === "evaluation" ? "c2" : "c1";
  const paths = useMemo(
    () => (evaluation ? addTrails(trails.current, cars, colorOf) : lines ? lapLines(lines) : []),
    [evaluation ? scene : lines],
  );
  const marks = (shown ? [shown, ...cars.filter((each) => each !== shown)] : cars).map((each) => ({
    x: each.x,
    y: each.y,
    yaw: (each.yaw_deg * Math.PI) / 180,
    color: colorOf(each),
    name: many ? racers[each.racer].model : each === shown ? `car ${each.car + 1}` : "",
  }));
  const objects = (scene?.shown?.objects ?? []).map(({ x, y, yaw_deg: yaw }) => [
    ...[x, y, (yaw * Math.PI) / 180],
  ]);
  return html`<${TrackMap} label=${`Map of the track with the cars of ${name}`} height=${null} track=${track}
    paths=${paths} cars=${marks} objects=${objects} />`;
}

/**
 * @param {{runId: number, name: string, facts: Object}} props facts: where it can be seen, what it does, whose picture
 */
export function Worker({ runId, name, facts }) {
  const [visible, setVisible] = useState(false);
  const [pictured, setPictured] = useState(null);
  const place = useSeen(setVisible);
  const evaluation = name.startsWith("evaluation");
  const watched = visible && pageSeen.value;
  const live = facts.place === "live";
  const topic = (view) => (watched && live ? `live:${runId}:${name}:${view}` : null);
  const state = useTopic(topic("state")).value ?? {};
  const scene = useTopic(topic("scene"), WORDS_MS).value?.scene ?? null;
  const worker = /^sim-(\d+)$/.exec(name)?.[1];
  const laps = useTopic(watched && worker ? `laps:${runId}:${worker}` : null);
  const world = scene?.world ?? facts.world;
  const track = useTrack(world);
  const known = useRef(0);
  const [choose] = useAction((car) => post("/api/live/car", { run_id: runId, worker: name, car }));

  const cars = here(scene);
  const shown = cars.find((each) => each.car === scene.shown?.car);
  const racers = scene?.racers ?? [];
  const many = racers.length > 1;
  known.current = Math.max(
    known.current,
    facts.car === null ? 0 : (facts.car ?? -1) + 1,
    ...cars.map((each) => each.car + 1),
  );
  const [does, hint] = words(facts, state);
  const title = !evaluation
    ? name
    : `${many ? "Race" : "Evaluation"}${racers.length ? ` of ${racers.map((racer) => racer.model).join(" and ")}` : ""}`;
  const wait = live ? "Waiting for the first picture." : "No picture.";
  const pictures = [
    ["camera", "Camera", `What the car of ${name} sees`, [160, 120]],
    ["chase", "View from behind", `The car of ${name} from behind`, [320, 240]],
  ];
  return html`
    <article class="live-card" ref=${place} aria-labelledby=${`live-${name}`} data-worker=${name} data-place=${facts.place}>
      <div class="live-card-head">
        <h3 id=${`live-${name}`}>${title}</h3>
        ${
          facts.place !== "bucket" &&
          html`<${Choice} label="Car" value=${String(facts.car ?? "")}
          options=${[["", "the one that has come furthest"], ...Array.from({ length: known.current }, (_, k) => [String(k), String(k + 1)])]}
          onChange=${(value) => choose(value === "" ? null : Number(value))} />`
        }
      </div>
      <p class=${`live-does${state.state?.waits ? " waits" : ""}`} role="status">${does}</p>
      <p class="live-hint quiet">${laps.error ? `${laps.error.message} The lines on the map are older.` : hint}</p>
      <div class="live-body">
        ${
          facts.place !== "bucket" &&
          html`<div class="live-views">
          ${pictures.map(
            ([
              view,
              heading,
              label,
              size,
            ]) => html`<${LivePicture} key=${view} topic=${topic(view)} name=${heading}
              label=${label} size=${size} wait=${wait} car=${view === "chase" ? pictured : null}
              onCar=${view === "camera" ? setPictured : undefined} />`,
          )}
        </div>`
        }
        <div class="live-map">
          <${LiveMap} topic=${topic("scene")} name=${name} evaluation=${evaluation} lines=${laps.value} track=${track.lines} />
          <p class="live-legend quiet">${track.error ? `There is no map: ${track.error.message}` : legend(scene, cars, { many, evaluation, laps: laps.value, place: facts.place })}</p>
        </div>
        ${
          facts.place !== "bucket" &&
          html`<div class="live-figures"><${Tiles} values=${figuresOf(shown)} /></div>
          <div class="live-details">
            <${Policy} actions=${scene?.actions ?? []} shown=${scene?.shown} />
            <${Finished} episodes=${scene?.finished ?? []} />
          </div>`
        }
      </div>
    </article>`;
}

function legend(scene, cars, { many, evaluation, laps, place }) {
  if (place === "bucket" && laps)
    return laps.iteration === null
      ? "The first iteration has not been finished yet."
      : `Lines: iteration ${laps.iteration}, the newest in the bucket; green where the lap was completed.`;
  if (!scene) return "";
  if (many) return scene.racers.map((racer) => `${racer.model}: ${racer.color}`).join(", ");
  const where = [scene.world, scene.reverse && "reversed", scene.checkpoint?.replace(".ckpt", "")];
  const lines =
    !evaluation && (laps?.iteration ?? null) !== null
      ? `Lines: iteration ${laps.iteration}, green where the lap was completed.`
      : "";
  return `${number(cars.length)} ${cars.length === 1 ? "car" : "cars"}, ${where.filter(Boolean).join(", ")}. ${lines}`;
}
