// Plays stored episodes step by step, one lap or two side by side.

import { EpisodeChooser } from "/episode_chooser.js";
import { useLap } from "/episode_data.js";
import { EpisodePane } from "/episode_pane.js";
import { Curve, Gain } from "/lap_curves.js";
import { Playback, carAt, lastAt, pressKey, usePlayer, valueAt } from "/lap_player.js";
import { setQuery, useGet } from "/store.js";
import { number } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Choice, Failure, Folded, Tick, html, useEffect, useMemo, useRef, useState } from "/ui.js";

export const title = "Episodes";

const COLORS = ["c1", "c2"];
const NAMES = ["first lap", "second lap"];
// What the path on the map may show, by the column of the lap.
const PATHS = {
  driven: { column: "driven_mps", name: "Speed driven", unit: "m/s", digits: 2 },
  speed: { column: "speed_mps", name: "Speed asked for", unit: "m/s", digits: 2 },
  reward: { column: "reward", name: "Reward", digits: 3 },
  steering: { column: "steering_deg", name: "Steering", unit: "°", digits: 1 },
  action: { column: "action", name: "Number of the action", digits: 0 },
};
const CURVES = [
  { title: "Speed", unit: "m/s", lines: { driven: "driven_mps", "asked for": "speed_mps" } },
  { title: "Steering", unit: "°", digits: 1, lines: { steering: "steering_deg" } },
  { title: "Reward of a step", digits: 3, lines: { reward: "reward" } },
];
const KEYS = [
  ["Space or K", "play, pause"],
  ["← →", "one step"],
  ["Shift ← →", "one second"],
  ["Home, End", "beginning, end"],
  ["+ −", "faster, slower"],
  ["E", "explanation map on and off"],
];

/** The names in the query of the first or the second lap. @param {number} k @param {any} lap */
const named = (k, { model, trace, episode }) =>
  k
    ? { other_model: model, other_trace: trace, other_episode: episode }
    : { model, trace, episode };

/** The address of this page with another query; null leaves a name out. */
function linkOf(query, changes) {
  const all = Object.entries({ ...Object.fromEntries(query), ...changes, step: null });
  return `#/play?${new URLSearchParams(all.filter(([, value]) => (value ?? null) !== null))}`;
}

export function Page({ query }) {
  const { model, ...asked } = Object.fromEntries(query);
  const first = asked.trace && { model, trace: asked.trace, episode: asked.episode ?? "0" };
  const second = first &&
    asked.other_trace && {
      model: asked.other_model ?? model,
      trace: asked.other_trace,
      episode: asked.other_episode ?? "0",
    };
  const found = [useLap(first || null), useLap(second || null)].slice(0, second ? 2 : 1);
  const laps = found.every((each) => each.data) && found.map((each) => each.data);
  const { error, again } = found.find((each) => each.error) ?? {};
  const [open, setOpen] = useState({});
  const chooser = (k) => html`<${EpisodeChooser} key=${k} action=${k ? "Compare" : "Play"}
    chosen=${(k ? second : null) || first || { model }}
    link=${(chosen) => linkOf(query, named(k, chosen))} />`;
  if (!first)
    return html`
    <h1>Episodes</h1>
    <p>Every stored episode of a training or an evaluation can be played step by step.</p>
    <div class="choosers">${chooser(0)}</div>`;
  const folds = [
    "Choose another episode",
    second ? "Choose another second lap" : "Compare with a second lap",
  ];
  return html`
    <h1>Episodes</h1>
    <div class="player">
      ${!laps && !error && html`<p class="quiet">The episode is read; the first time this takes some seconds …</p>`}
      ${
        error &&
        html`<${Failure} error=${error} />
          <p class="actions"><button type="button" onClick=${again}>Try again</button></p>`
      }
      ${laps && html`<${Player} key=${JSON.stringify([first, second])} laps=${laps} query=${query} />`}
    </div>
    <div class="choosers">${folds.map(
      (
        text,
        k,
      ) => html`<${Folded} key=${k} title=${text} open=${open[k] ?? (k === 0 && Boolean(error))}
        onToggle=${(on) => setOpen((old) => ({ ...old, [k]: on }))}>${chooser(k)}<//>`,
    )}</div>`;
}

function paneLinks(data, k, query) {
  const here = Number(data.query.episode);
  const link = (text, changes) =>
    html`<a key=${text} class="button short" href=${linkOf(query, changes)}>${text}</a>`;
  const of = (episode) => named(k, { ...data.query, episode });
  return [
    here > 0 && link("Previous episode", of(here - 1)),
    here + 1 < data.facts.episodes.length && link("Next episode", of(here + 1)),
    k > 0 && link("Remove the second lap", named(1, {})),
  ];
}

/** The fastest line that is known, as a path of the map. */
function lineOf(limit) {
  if (!limit) return [];
  const points = [...limit.line, limit.line[0]];
  const [x, y] = [0, 1].map((k) => points.map((each) => each[k]));
  return [{ x, y, color: "c3" }];
}

/** The player of one or two laps. @param {{laps: any[], query: URLSearchParams}} props */
function Player({ laps, query }) {
  const lead = laps[0];
  const two = laps.length > 1;
  const over = two && query.get("align") === "progress" ? "progress" : "time";
  const path = PATHS[query.get("path")] ? query.get("path") : "driven";
  /** What both laps are aligned by: seconds, or percent of the lap. */
  const axis = (data, by = over) => (by === "time" ? data.lap.time_s : data.progress);
  const axes = laps.map((data) => axis(data));
  const start = axes[0][Math.min(Math.max(Number(query.get("step")) || 0, 0), lead.rows - 1)];
  const player = usePlayer(axes, start, (now, seconds) =>
    over === "time" ? now + seconds : progressAfter(lead, now, seconds),
  );
  const { at, seek } = player;
  const [numbers, setNumbers] = useState(false);
  const rows = axes.map((values) => lastAt(values, at));
  const align = (by) => {
    setQuery({ align: by === "time" ? "" : by });
    seek(axis(lead, by)[rows[0]]);
  };
  const seekPlace = (x, y) => {
    const far = lead.lap.x.map((each, k) => Math.hypot(each - x, lead.lap.y[k] - y));
    const least = far.reduce((best, each) => Math.min(best, each), Infinity);
    if (least < 1) seek(axes[0][far.indexOf(least)]);
  };
  const keys = useRef(null);
  keys.current = {
    ...player.keys,
    e: () => laps.forEach((data) => data.checkpoint !== null && data.explain(!data.explains)),
  };
  useEffect(() => {
    const press = (event) => pressKey(event, keys.current);
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  }, []);

  const { world, reverse } = lead.facts;
  const lined = query.get("line") !== "off";
  const limit = useGet(
    world && lined ? `/api/track/limit?${new URLSearchParams({ world, reverse })}` : null,
  );
  const paths = useMemo(
    () => [
      ...laps.map(({ lap }, k) => {
        const line = { x: lap.x, y: lap.y };
        return k
          ? { ...line, color: COLORS[k], dashed: true }
          : {
              ...line,
              ...PATHS[path],
              values: lap[PATHS[path].column].map((each) => (each === null ? NaN : Number(each))),
            };
      }),
      ...lineOf(limit.value),
    ],
    [laps, path, limit.value],
  );
  const cars = laps.map(({ lap }, k) => ({
    ...carAt(lap, axes[k], at),
    color: COLORS[k],
    name: two ? String(k + 1) : "",
  }));
  const { objects } = lead.lap;
  const position = laps
    .map(
      ({ lap, rows: all }, k) =>
        `${two ? `${k + 1}: ` : ""}step ${number(rows[k] + 1)} of ${number(all)}, ${number(lap.time_s[rows[k]], 2)} s, ${number(lap.progress[rows[k]], 1)} %`,
    )
    .join(" · ");
  const version = laps.map((data) => data.version.value).join(" ");
  const critic = useMemo(() => laps.map((data) => [data.values()]), [laps, version]);
  const valued = laps.some(
    (data, k) => data.checkpoint !== null && critic[k][0].some((each) => each !== null),
  );
  const laid = { laps, names: NAMES, colors: COLORS, over, x: axes, at, rows, seek };
  const curves = html`
    <div class="lap-curves">
      ${two && html`<${Gain} ...${laid} />`}
      ${CURVES.map((each) => html`<${Curve} key=${each.title} ...${each} ...${laid} />`)}
      ${valued && html`<${Curve} key="critic" title="What the critic expects" lines=${{ value: "" }} values=${critic} ...${laid} />`}
    </div>`;
  const pane = (k) => html`<${EpisodePane} key=${k} data=${laps[k]} row=${rows[k]} name=${NAMES[k]}
    color=${COLORS[k]} links=${paneLinks(laps[k], k, query)} />`;
  const shows = Object.keys(PATHS).filter(
    (key) => key !== "action" || lead.lap.action.some((each) => Number.isFinite(Number(each))), // continuous actions have no number
  );
  return html`
    <div class=${`player-grid${two ? " two" : ""}`}>
      ${pane(0)}
      <section class="map-part" aria-label="Map">
        <${TrackMap} label=${`Track with the driven path${two ? "s of both laps and the cars" : " and the car"}`}
          track=${lead.facts.outline ?? laps.at(-1).facts.outline} paths=${paths} cars=${cars}
          objects=${objects[Math.min(rows[0], objects.length - 1)]} numbers=${numbers} pick=${seekPlace} zooms />
        <p class="actions">
          <${Choice} label="Path shows" options=${shows.map((key) => [key, PATHS[key].name])} value=${path}
            onChange=${(key) => setQuery({ path: key === "driven" ? "" : key })} />
          <${Tick} label="Waypoint numbers" on=${numbers} set=${setNumbers} />
          <${Tick} label="Best known line" on=${lined} set=${(on) => setQuery({ line: on ? "" : "off" })} />
        </p>
        ${lined && limit.value && html`<p class="quiet">Best known line: ${limit.value.text}</p>`}
        ${lined && limit.error && html`<p class="quiet">${limit.error.message}</p>`}
        ${!two && curves}
      </section>
      ${two && pane(1)}
    </div>
    ${two && curves}
    <${Playback} player=${player} position=${position}>
      ${two && html`<${Choice} label="Align by" options=${["time", "progress"]} value=${over} onChange=${align} />`}
    <//>
    <details class="folded">
      <summary>Keys</summary>
      <dl class="keys">${KEYS.map(([key, what]) => html`<div key=${key}><dt><kbd>${key}</kbd></dt><dd>${what}</dd></div>`)}</dl>
    </details>`;
}

/** Progress of the lap after so many seconds more than at a progress. */
function progressAfter({ lap, progress }, at, seconds) {
  if (at >= progress.at(-1)) return at + 5 * seconds; // another lap has come further
  return valueAt(lap.time_s, progress, valueAt(progress, lap.time_s, at) + seconds);
}
