// The map of the report: all steps as areas, or laps that are played, coloured by what was driven.

import { Playback, carAt, lastAt, pressKey, usePlayer } from "/lap_player.js";
import { columns, unpacked } from "/packed.js";
import { number, short } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Choice, Table, Tick, html, useMemo, useState } from "/ui.js";

const SQUARE = [
  [-1, -1],
  [1, -1],
  [1, 1],
  [-1, 1],
];
const KEYS =
  "Space plays and pauses, the left and right arrow keys move by a step, page up and page down change the iteration, plus and minus the speed.";

/** The laps of the map: columns of their steps, and facts. */
function lapsOf(map) {
  const { first, ...facts } = columns(map.laps);
  const steps = Object.entries(columns(map.steps));
  return Array.from(facts.id, (id, k) => {
    const own = steps.map(([name, values]) => [name, values.subarray(first[k], first[k + 1])]);
    const [iteration, episode] = [facts.iteration[k], facts.episode[k]];
    return {
      ...{ id, iteration, status: map.statuses[facts.status[k]] },
      short: iteration < 0 ? `trial ${episode + 1}` : String(episode),
      name:
        iteration < 0
          ? `evaluation, trial ${episode + 1}`
          : `iteration ${iteration}, episode ${episode}`,
      total: { progress: facts.progress[k], time: facts.time[k], reward: facts.reward[k] },
      steps: Object.fromEntries(own),
    };
  });
}

/** Where episodes ended. */
function endsOf({ ends, statuses }) {
  const { x, y, id, period, status } = columns(ends);
  const at = (k) => ({
    x: x[k],
    y: y[k],
    id: id[k],
    period: period[k],
    status: statuses[status[k]],
  });
  return Array.from(id, (_, k) => at(k));
}

/** The places that were driven in a period, as areas of the map. */
function cellsOf({ cells, paints }, period, paint) {
  const [xs, ys] = [unpacked(cells.x), unpacked(cells.y)];
  const values = columns(cells.periods[period]);
  const known = [...xs.keys()].filter((k) => Number.isFinite(values[paint][k]));
  const corners = known.map((k) =>
    SQUARE.map(([i, j]) => [xs[k] + (i * cells.size) / 2, ys[k] + (j * cells.size) / 2]),
  );
  const about = (k) =>
    `Here, mean of ${number(values.visits[k])} steps: ${wordsOf((name) => values[name][k])}`;
  return {
    ...{ corners, values: known.map((k) => values[paint][k]), ...paints[paint] },
    places: known.map((k) => ({ x: xs[k], y: ys[k], text: about(k) })),
  };
}

const wordsOf = (value) =>
  `${number(value("driven"), 1)} m/s (requested ${number(value("speed"), 1)}), steering ${number(value("steering"))}°, slip ${number(value("slip"))}°, reward ${short(value("reward"))}`;

const stepText = ({ name, steps }, row) =>
  `${name} at ${number(steps.time_s[row], 1)} s: ${wordsOf((column) => steps[column][row])}, progress ${number(steps.progress[row], 1)} %`;

export function ReportMap({ map }) {
  const all = useMemo(() => lapsOf(map), [map]);
  const ends = useMemo(() => endsOf(map), [map]);
  const { iterations } = map;
  const [what, setWhat] = useState("both");
  const [place, setPlace] = useState(Math.max(iterations.length - 1, 0));
  const [wanted, setPaint] = useState("lap");
  const [endsShown, showEnds] = useState(false);
  const [hidden, setHidden] = useState([]);
  const [followed, follow] = useState(null);
  const [told, tell] = useState({ at: NaN, text: "" });

  const period = what.startsWith("steps-") ? Number(what.slice(6)) : null;
  const laps = useMemo(() => {
    if (what === "iteration") return all.filter((lap) => lap.iteration === iterations[place]);
    return (map.groups[what] ?? []).map((k) => all[k]);
  }, [what, place]);
  const shown = useMemo(() => laps.filter((lap) => !hidden.includes(lap)), [laps, hidden]);
  const lead = followed ?? laps[0];
  const times = [lead, ...laps.filter((lap) => lap !== lead)].map(
    (lap) => lap?.steps.time_s ?? [0],
  );
  const player = usePlayer(times, Infinity);
  const { at, seek } = player;
  const choose = (next, iteration = place) => {
    setWhat(next);
    setPlace(Math.min(Math.max(iteration, 0), iterations.length - 1));
    setHidden([]);
    follow(null);
    seek(Infinity);
  };

  // A lap has a colour of its own, an area none; how often a place was driven is said of areas only.
  const paints = Object.keys(map.paints).filter((key) => key !== (laps.length ? "visits" : "lap"));
  const paint = paints.includes(wanted) ? wanted : paints[0];
  const inkOf = (lap) =>
    what === "both" ? map.colors[laps.indexOf(lap)] : `lap${1 + (laps.indexOf(lap) % 8)}`;
  const paths = useMemo(
    () =>
      shown.flatMap((lap) => {
        const { x, y, time_s: time, [paint]: values } = lap.steps;
        const line = (rows, look) => ({
          ...{ x: x.subarray(0, rows), y: y.subarray(0, rows), far: 0.6 * map.every },
          ...{ width: laps.length > 6 ? 2 : 3, ...look },
        });
        const driven = lastAt(time, at) + 1;
        const look = values
          ? { ...map.paints[paint], values: values.subarray(0, driven) }
          : { color: inkOf(lap) };
        const rest = driven < x.length ? [line(x.length, { color: "faint", alpha: 0.4 })] : [];
        return [line(driven, look), ...rest];
      }),
    [shown, paint, at],
  );
  const cells = useMemo(
    () => (period === null ? null : cellsOf(map, period, paint)),
    [period, paint],
  );
  const ended = useMemo(() => {
    if (!endsShown) return [];
    const ids = new Set(shown.map((lap) => lap.id));
    const isShown = (end) => (laps.length ? ids.has(end.id) : !period || end.period === period);
    return ends.filter(isShown);
  }, [endsShown, shown, period]);
  const dots = useMemo(() => ended.map(({ x, y, status }) => [x, y, status.color]), [ended]);
  const cars = shown.map((lap) => ({
    ...carAt(lap.steps, lap.steps.time_s, at),
    color: inkOf(lap),
  }));

  /** The step or the area near a place of the map. */
  const nearest = (x, y, near) => {
    let best = { far: near, lap: null, row: 0, text: "" };
    for (const lap of shown)
      lap.steps.x.forEach((each, row) => {
        const far = Math.hypot(each - x, lap.steps.y[row] - y);
        if (far < best.far) best = { far, lap, row, text: "" };
      });
    for (const each of cells?.places ?? []) {
      const far = Math.hypot(each.x - x, each.y - y);
      if (far < best.far) best = { far, lap: null, row: 0, text: each.text };
    }
    return best;
  };
  const hover = (...place_) => {
    if (player.playing) return;
    const { lap, row, text } = nearest(...place_);
    tell({ at, text: lap ? stepText(lap, row) : text });
  };
  const pick = (...place_) => {
    const { lap, row } = nearest(...place_);
    hover(...place_);
    if (!lap) return;
    follow(lap);
    seek(lap.steps.time_s[row]);
  };
  const text =
    (told.at === at && told.text) || (lead ? stepText(lead, lastAt(lead.steps.time_s, at)) : "");
  const keys = {
    ...(lead && player.keys),
    PageUp: () => choose("iteration", what === "iteration" ? place + 1 : place),
    PageDown: () => choose("iteration", what === "iteration" ? place - 1 : place),
  };
  const present = new Set(ended.map((end) => end.status));
  const swatch = (color) =>
    html`<span class="swatch dots" style=${{ background: `var(--${color})` }}></span>`;
  return html`
    <div class="controls">
      <${Choice} label="Show" options=${map.shows} value=${what} onChange=${(value) => choose(value)} />
      <${Choice} label="Colours" options=${paints.map((key) => [key, map.paints[key].name])} value=${paint} onChange=${setPaint} />
      <${Tick} label="where episodes ended" on=${endsShown} set=${showEnds} />
      ${
        what === "iteration" &&
        html`<label class="wide"><span>Iteration <output>${iterations[place]}</output></span>
          <input type="range" min="0" max=${iterations.length - 1} value=${place} aria-valuetext=${`iteration ${iterations[place]}`}
            onInput=${(event) => choose(what, Number(event.currentTarget.value))} /></label>`
      }
    </div>
    <div class="played" tabindex="0" role="group" aria-label=${`Map of the track. ${KEYS}`} onKeyDown=${(event) => pressKey(event, keys)}>
      <${TrackMap} label="Map of the track" height="track" within=${map.bounds} track=${map.track} paths=${paths} cells=${cells}
        dots=${dots} cars=${cars} numbers pick=${pick} hover=${hover} zooms />
      ${present.size > 0 && html`<p class="keys">${[...present].map((each) => html`<span class="key">${swatch(each.color)}${each.name}</span>`)}</p>`}
      ${lead ? html`<${Playback} player=${player} position=${text} />` : html`<p class="readout">${text}</p>`}
    </div>
    ${
      lead &&
      html`<div class="laps"><${Table} caption="Laps on the map" heads=${["Episode", "Iteration", "Read", "Progress", "Time", "Reward", "End"]} rows=${laps.map(
        (lap) => [
          html`<${Tick} label=${html`${swatch(inkOf(lap))}${lap.short}`} title=${lap.name} on=${!hidden.includes(lap)}
          set=${(on) => setHidden([...hidden.filter((each) => each !== lap), ...(on ? [] : [lap])])} />`,
          lap.iteration < 0 ? "–" : lap.iteration,
          html`<input type="radio" name="followed" checked=${lap === lead} aria-label=${`Read the numbers of ${lap.name}`} onChange=${() => follow(lap)} />`,
          `${number(lap.total.progress, 1)} %`,
          `${number(lap.total.time, 2)} s`,
          short(lap.total.reward),
          lap.status.name,
        ],
      )} /></div>`
    }`;
}
