// One worker: camera, view from behind, map with all cars, figures, what the policy wants, last episodes.

import { post } from "/api.js";
import { LivePicture, addTrails, pageSeen, useTrack } from "/live_picture.js";
import { useAction, useTopic } from "/store.js";
import { number } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Choice, Tiles, html, useMemo, useRef, useSeen, useState } from "/ui.js";

const WORDS_MS = 450; // numbers that change faster cannot be read
const FIGURES = [
  "Speed",
  "Steering",
  "Progress",
  "Reward of the step",
  "Reward so far",
  "Lap time",
];
const PICTURES = [
  {
    view: "camera",
    name: "Camera",
    about: (name) => `What the car of ${name} sees`,
    size: [160, 120],
  },
  {
    view: "chase",
    name: "View from behind",
    about: (name) => `The car of ${name} from behind`,
    size: [320, 240],
  },
];

/** Probabilities of discrete actions as bars, or mean and spread; what the critic expects. */
const Policy = ({ actions = [], shown, text }) => html`
  <div>
    <h4>Actions</h4>
    <ul class="live-bars" tabindex="0" aria-label="Probabilities of the actions">
      ${actions.map((action, k) => {
        const share = shown?.probabilities?.[k];
        return html`<li key=${k} class=${shown?.chosen === k ? "taken" : null}>
          <span>${action}</span>
          <span class="live-bar-room"><span class="live-bar-fill" style=${{ transform: `scaleX(${share ?? 0})` }}></span></span>
          <span class="live-bar-share">${share === undefined ? "–" : number(100 * share, 0, "%")}</span>
        </li>`;
      })}
    </ul>
    <p class="quiet live-value">${text}</p>
  </div>`;

const Finished = ({ texts = [] }) => html`
  <div>
    <h4>Last episodes</h4>
    <ol class="live-finished">${texts.map((text) => html`<li>${text}</li>`)}</ol>
  </div>`;

/** Lines of the newest iteration, the last one on top. */
function lapLines(laps) {
  const lines = [...laps.lines].reverse();
  const step = 0.65 / Math.max(lines.length, 1);
  return lines.map(({ x, y, progress }, k) => ({
    ...{ x, y, color: progress >= 100 ? "c3" : "faint", alpha: Math.max(0.12, 0.8 - step * k) },
  }));
}

/** The cars on the track: only this is drawn again for every scene. `laps` are those of the newest iteration. */
function LiveMap({ topic, name, evaluation, laps, track }) {
  const { cars = [], objects } = useTopic(topic).value?.words ?? {};
  const trails = useRef(new Map());
  const paths = useMemo(() => {
    if (evaluation) return addTrails(trails.current, cars, ({ color }) => color);
    return laps ? lapLines(laps) : [];
  }, [evaluation ? cars : laps]);
  return html`<${TrackMap} label=${`Map of the track with the cars of ${name}`} height=${null} track=${track}
    paths=${paths} cars=${cars} objects=${objects} />`;
}

/**
 * @param {{runId: number, name: string, facts: Object}} props facts: the card that the server tells of it
 */
export function Worker({ runId, name, facts }) {
  const [visible, setVisible] = useState(false);
  const [pictured, setPictured] = useState(null);
  const place = useSeen(setVisible);
  const watched = visible && pageSeen.value;
  const live = facts.place === "live";
  const near = facts.place !== "bucket";
  const topic = (view) => (watched && live ? `live:${runId}:${name}:${view}` : null);
  const state = useTopic(topic("state")).value;
  const { scene, words = {} } = useTopic(topic("scene"), WORDS_MS).value ?? {};
  const worker = /^sim-(\d+)$/.exec(name)?.[1];
  const laps = useTopic(watched && worker ? `laps:${runId}:${worker}` : null);
  const track = useTrack(scene?.world ?? facts.world);
  const known = useRef(0);
  const [choose] = useAction((car) => post("/api/live/car", { run_id: runId, worker: name, car }));
  const numbers = [facts.car ?? -1, ...(scene?.cars ?? []).map((each) => each.car)];
  known.current = Math.max(known.current, ...numbers.map((car) => car + 1));
  const { does, hint } = live ? (state?.words ?? {}) : facts;
  const wait = live ? "Waiting for the first picture." : "No picture.";
  const legend = track.error
    ? `There is no map: ${track.error.message}`
    : [words.legend, laps.value?.text].filter(Boolean).join(" ");
  return html`
    <article class="live-card" ref=${place} aria-labelledby=${`live-${name}`} data-worker=${name} data-place=${facts.place}>
      <div class="live-card-head">
        <h3 id=${`live-${name}`}>${words.title || (worker ? name : "Evaluation")}</h3>
        ${
          near &&
          html`<${Choice} label="Car" value=${String(facts.car ?? "")}
          options=${[["", "the one that has come furthest"], ...Array.from({ length: known.current }, (_, k) => [String(k), String(k + 1)])]}
          onChange=${(value) => choose(value === "" ? null : Number(value))} />`
        }
      </div>
      <p class=${`live-does${state?.state?.waits ? " waits" : ""}`} role="status">${does}</p>
      <p class="live-hint quiet">${laps.error ? `${laps.error.message} The lines on the map are older.` : hint}</p>
      <div class="live-body">
        ${
          near &&
          html`<div class="live-views">
          ${PICTURES.map(
            (each) => html`<${LivePicture} key=${each.view} ...${each} topic=${topic(each.view)}
              label=${each.about(name)} wait=${wait} car=${each.view === "chase" ? pictured : null}
              onCar=${each.view === "camera" ? setPictured : undefined} />`,
          )}
        </div>`
        }
        <div class="live-map">
          <${LiveMap} topic=${topic("scene")} name=${name} evaluation=${!worker} laps=${laps.value} track=${track.lines} />
          <p class="live-legend quiet">${legend}</p>
        </div>
        ${
          near &&
          html`<div class="live-figures"><${Tiles} values=${FIGURES.map((each, k) => [each, words.figures?.[k]])} /></div>
          <div class="live-details">
            <${Policy} actions=${words.actions} shown=${scene?.shown} text=${words.policy} />
            <${Finished} texts=${words.finished} />
          </div>`
        }
      </div>
    </article>`;
}
