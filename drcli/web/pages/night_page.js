// A race for a projector: leaderboard, who drives now and how, what comes next, the last result, and the winner.

import { aboutField } from "/ask.js";
import { LivePicture, addTrails, pageSeen, useTrack } from "/live_picture.js";
import { Pairs } from "/race_pairs.js";
import { driversText, inPairs, raceLink, videoPath } from "/race_words.js";
import { useTopic } from "/store.js";
import { andResets, duration, mean, number } from "/text.js";
import { TrackMap } from "/track_map.js";
import { Failure, html, signal } from "/ui.js";
import { useEffect, useLayoutEffect, useMemo, useRef, useState } from "/vendor/preact/preact.js";

export const title = "Race night";

const SLIDE_MS = 12_000;
const LAST_MS = 15_000;
const REST_MS = 4000;
const START_S = 5; // after it, a worker has its live view
const ROWS = 8; // more become too small to be read from far away
const MOVE = { duration: 900, easing: "ease-in-out" };
const SPLITS = [100 / 3, 200 / 3];
const still = matchMedia("(prefers-reduced-motion: reduce)");
const phone = matchMedia("(max-width: 900px)");
const isNarrow = signal(phone.matches);
phone.addEventListener("change", () => {
  isNarrow.value = phone.matches;
});
const isFull = signal(false);
document.addEventListener("fullscreenchange", () => {
  isFull.value = Boolean(document.fullscreenElement);
});

/** Whether nobody has moved or typed anything for a while. */
const isResting = signal(false);
let rest = 0;
const wake = () => {
  isResting.value = false;
  clearTimeout(rest);
  rest = setTimeout(() => (isResting.value = true), REST_MS);
};
for (const name of ["pointermove", "keydown", "focusin"]) addEventListener(name, wake);

export function Page({ params: [id] }) {
  const { value: race, error } = useTopic(`race:${id}`);
  useEffect(() => {
    if (race) document.title = `${race.rules.name} – Race night`;
  }, [race?.rules.name]);
  const trouble = error && html`<${Failure} error=${aboutField(error)} />`;
  if (race) return html`<${Night} id=${id} race=${race} trouble=${trouble} />`;
  return html`<div class="night"><h1>Race night</h1><div role="status">${trouble}</div></div>`;
}

function Night({ id, race, trouble }) {
  const place = useRef(null);
  const [slide, setSlide] = useState(0);
  const [paused, setPaused] = useState(false);
  const [refused, setRefused] = useState(false);
  const cars = useDrivers(race);
  const rows = boardRows(race, cars.drivers);
  const size = isNarrow.value ? Infinity : ROWS;
  const pages = Math.max(1, Math.ceil(rows.length / size));
  const slides = [
    ...(race.winner ? ["winner"] : []),
    ...Array.from({ length: pages }, (_, k) => k),
    ...(race.pairs.length ? ["pairs"] : []),
  ];
  const count = slides.length;
  const at = Math.min(slide, count - 1);
  const shown = slides[at];
  const turn = (by) => setSlide((at + by + count) % count);

  useEffect(() => setSlide(0), [race.winner]);
  useEffect(() => {
    if (paused || count < 2) return undefined;
    const timer = setTimeout(() => turn(1), SLIDE_MS);
    return () => clearTimeout(timer);
  }, [paused, at, count]);
  const fullScreen = () =>
    (document.fullscreenElement
      ? document.exitFullscreen()
      : place.current.requestFullscreen()
    ).catch(() => setRefused(true));
  const press = (event) => {
    const typed = event.target.closest?.("input, select, textarea, dialog");
    if (event.ctrlKey || event.metaKey || event.altKey || typed) return;
    const next = () => turn(1);
    const previous = () => turn(-1);
    const does = {
      ...{ ArrowRight: next, PageDown: next, ArrowLeft: previous, PageUp: previous },
      ...{ f: fullScreen, p: () => setPaused(!paused) },
    }[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!does) return;
    event.preventDefault();
    does();
  };
  useEffect(() => {
    addEventListener("keydown", press);
    return () => removeEventListener("keydown", press);
  });

  const alone = shown === "winner" || shown === "pairs";
  const { rules, words } = race;
  return html`
    <div ref=${place} class=${isResting.value ? "night night-still" : "night"}>
      <header><h1>${rules.name}</h1><p class="night-facts">${words.place}. ${words.decides}</p></header>
      <div role="status">${trouble}${refused && html`<p>This browser does not allow full screen here; its own key is often F11.</p>`}</div>
      <div class="night-body">
        <section class="night-stage" aria-label="Leaderboard">
          ${shown === "winner" && html`<${Winner} race=${race} />`}
          ${shown === "pairs" && html`<${AllPairs} race=${race} />`}
          ${!alone && html`<${Board} race=${race} first=${Number(shown) * ROWS || 0} rows=${rows.slice(Number(shown) * size || 0, (Number(shown) + 1) * size)} />`}
          ${count > 1 && html`<p class="night-dots" aria-hidden="true">${slides.map((each, k) => html`<span key=${each} class=${k === at && "on"}></span>`)}</p>`}
        </section>
        <div class="night-side"><${Side} id=${id} race=${race} cars=${cars} /></div>
      </div>
      <${LastResult} race=${race} />
      <p class="night-bar actions">
        <a class="button" href=${raceLink(id)}>Back to the race</a>
        <button type="button" onClick=${() => turn(-1)}>Previous</button>
        <button type="button" onClick=${() => turn(1)}>Next</button>
        <button type="button" aria-pressed=${String(paused)} onClick=${() => setPaused(!paused)}>Pause</button>
        <button type="button" onClick=${fullScreen}>${isFull.value ? "Leave full screen" : "Full screen"}</button>
        <span class="night-keys">Keys: F full screen, arrows previous and next, P pause</span>
      </p>
    </div>`;
}

/** The cars that drive now, as their worker shows them, with their laps and the splits of this lap. */
function useDrivers(race) {
  const { driving } = race.moments;
  const live = driving && pageSeen.value ? race.live : null;
  const topic = live && `live:${live.run_id}:${live.worker}`;
  const told = useTopic(topic && `${topic}:scene`).value;
  const seen = useRef(new Map());
  // The last scene stays until the result is there: a film may be made first.
  const kept = useRef(null);
  if (told?.scene && driving) kept.current = { key: driving.key, ...told };
  const { scene = null, words } = (kept.current?.key === driving?.key && kept.current) || {};
  const drivers = useMemo(() => {
    if (!driving) seen.current.clear();
    return (driving?.cars ?? []).map((car) => {
      const named = (scene?.racers ?? []).findIndex((racer) =>
        racer.model?.includes(`-${car.submission}/`),
      );
      const racer = named < 0 && driving.cars.length === 1 ? 0 : named;
      const shown = scene?.cars.find((each) => each.racer === racer) ?? null;
      const laps = (scene?.finished ?? []).filter(
        (each) => each.racer === racer && each.ended_s >= driving.began_at,
      );
      if (shown) addSplits(seen.current, `${driving.key} ${car.submission}`, shown);
      const splits = seen.current.get(`${driving.key} ${car.submission}`)?.splits ?? [];
      return { ...car, shown, laps, splits };
    });
  }, [driving, scene]);
  return { topic, scene, words, drivers };
}

/** The time at which a car has passed each third of its lap, between two scenes. */
function addSplits(seen, key, { laps, progress, lap_s: now }) {
  const before = seen.get(key);
  const same = before?.lap === laps && now >= before.now;
  const splits = same ? before.splits : [];
  SPLITS.forEach((mark, k) => {
    if (!same || before.progress >= mark || progress < mark) return;
    const share = (mark - before.progress) / (progress - before.progress);
    splits[k] = before.now + share * (now - before.now);
  });
  seen.set(key, { lap: laps, progress, now, splits });
}

const clock = (seconds) =>
  `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(3).padStart(6, "0")}`;

/**
 * What the laps of a car that still drives come to, seconds; Infinity if nothing counts yet. Only clean laps do: what
 * penalties of others add is known at the end.
 */
export function resultSoFar({ ranking, min_laps: least, average_laps: many }, laps) {
  const times = laps.map((lap) => (lap.progress >= 100 && !lap.resets ? lap.time_s : Infinity));
  if (ranking === "best-lap")
    return times.filter(Number.isFinite).length < least ? Infinity : Math.min(...times);
  let row = 0;
  const rows = times.map((time) => (row = Number.isFinite(time) ? row + 1 : 0));
  if (ranking !== "best-average" || Math.max(...rows) < least) return Infinity;
  const averages = times.map((_, k) => mean(times.slice(k + 1 - many, k + 1)));
  return Math.min(...averages.slice(many - 1));
}

/** The rows of the board; who drives is in it with the result so far, which an average may still improve. */
function boardRows(race, drivers) {
  let rows = race.leaderboard.map(({ racer, rank, score_s: seconds, result: score, gap }) => ({
    ...{ racer, rank, seconds, score, gap, drives: drivers.some((car) => car.racer === racer) },
  }));
  const time = ({ seconds }) => seconds ?? Infinity;
  const open = race.rules.ranking === "best-average" ? " so far" : "";
  for (const { racer, laps } of inPairs(race) ? [] : drivers) {
    const old = rows.find((row) => row.racer === racer) ?? { seconds: null };
    const best = resultSoFar(race.rules, laps);
    if (best >= time(old)) continue;
    const others = rows.filter((row) => row !== old);
    const first = Math.min(...others.map(time));
    const gap = first < best ? `+${number(best - first, 3, "s")}${open}` : `leads${open || " now"}`;
    const row = { racer, rank: 0, seconds: best, score: clock(best), gap, drives: true };
    rows = [...others, row].sort((a, b) => time(a) - time(b) || 0);
    rows = rows.map((each, k) => ({ ...each, rank: each.rank === null ? null : k + 1 }));
  }
  return rows;
}

function Board({ race, rows, first }) {
  const list = useRef(null);
  const tops = useRef(new Map());
  useLayoutEffect(() => {
    const now = new Map([...(list.current?.children ?? [])].map((row) => [row.title, row]));
    for (const [racer, row] of now) {
      const top = row.offsetTop;
      const moved = (tops.current.get(racer) ?? top) - top;
      if (moved && !still.matches)
        row.animate([{ transform: `translateY(${moved}px)` }, { transform: "none" }], MOVE);
      now.set(racer, top);
    }
    tops.current = now;
  });
  if (!rows.length)
    return html`<p class="night-empty">${race.submissions.length ? "Nobody has driven yet." : race.state === "open" ? "Submit your model!" : "Nobody has submitted a model."}</p>`;
  return html`
    <ol ref=${list} class="night-board" start=${first + 1}>${rows.map(
      ({ racer, rank, score, gap, drives }) => html`
        <li key=${racer} title=${racer} class=${`${rank === 1 ? "first" : ""}${drives ? " drives" : ""}`}>
          <span class="night-rank">${rank ?? "–"}</span>
          <span class="night-racer">${racer}</span>
          <span class="night-score">${score}</span>
          <span class="night-gap">${gap}</span>
        </li>`,
    )}</ol>`;
}

function Winner({ race }) {
  const [first, ...others] = race.leaderboard;
  const podium = others.slice(0, 2).filter((row) => row.rank);
  return html`
    <div class="night-winner" role="status">
      <p>Winner</p>
      <p class="night-winner-name">${race.winner}</p>
      <p class="night-winner-score">${first.result}</p>
      ${podium.length > 0 && html`<p class="night-podium">${podium.map((row) => `${row.rank}. ${row.racer} ${row.result}`).join("   ")}</p>`}
    </div>`;
}

function AllPairs({ race }) {
  const box = useRef(null);
  // Smaller text until all pairs are seen; many of them are scrolled rather than made unreadable.
  useLayoutEffect(() => {
    const { current } = box;
    for (let share = 1; share > 0.4; share -= 0.1) {
      current.style.setProperty("--fit", share.toFixed(1));
      const tall = current.scrollHeight > current.clientHeight + 1;
      if (isNarrow.value || (!tall && current.scrollWidth <= current.clientWidth + 1)) return;
    }
  });
  return html`
    <h2>${race.rules.pairing === "bracket" ? "Bracket" : "Pairs"}</h2>
    <div ref=${box} class="night-pairs"><${Pairs} race=${race} /></div>`;
}

/** Who drives with pictures, then the film of it, and who is next. */
function Side({ id, race, cars }) {
  const { driving, last } = race.moments;
  const begun = useRef(last?.key);
  const [ended, setEnded] = useState("");
  const { films } = race;
  const fresh = last?.key !== begun.current && ended !== last?.key;
  const shown = films.length > 0 && ended !== `bad ${last.key}` && (!driving || fresh);
  const film = (key, k) => html`
    <video key=${key} autoplay muted playsinline loop=${!driving} src=${videoPath(id, key)}
      aria-label=${`Film of ${driversText(last)}${films.length > 1 ? `, camera ${k + 1}` : ""}`}
      onEnded=${() => setEnded(last.key)} onError=${() => setEnded(`bad ${last.key}`)}></video>`;
  return html`
    <section class="night-now" aria-label="Driven now"><h2>Now</h2>${driving ? html`<${Driving} key=${driving.key} race=${race} ...${cars} />` : html`<p class="quiet">${race.words.idle}</p>`}</section>
    ${
      shown &&
      html`<section class="night-film" aria-label="Film of the last run">
        <h2>${driversText(last)}</h2>
        <div class="night-films">${films.map(film)}</div>
      </section>`
    }
    ${!(driving && shown) && html`<${Next} race=${race} />`}`;
}

function Driving({ race, topic, scene, words, drivers }) {
  const [, setNow] = useState(0);
  const trails = useRef(new Map());
  const { lines, error } = useTrack(scene?.world ?? race.rules.world);
  const [pictured, setPictured] = useState(null);
  const { cars = [], objects } = words ?? {};
  const paths = useMemo(() => addTrails(trails.current, cars, (each) => each.color), [words]);
  const began = race.moments.driving.began_at;
  useEffect(() => {
    const timer = setInterval(() => setNow(Date.now()), 1000);
    return () => clearInterval(timer);
  }, []);
  const everybody = driversText({ cars: drivers });
  const whose = drivers.find(({ shown }) => shown?.car === pictured)?.racer ?? everybody;
  return html`
    ${drivers.map((car) => html`<${Driver} key=${car.submission} car=${car} laps=${race.rules.max_laps} began=${began} live=${Boolean(topic)} here=${race.here} />`)}
    ${
      (topic || scene) &&
      html`<div class="night-pictures">
        <${LivePicture} topic=${topic && `${topic}:camera`} name="Camera" label=${`What the car of ${whose} sees`} size=${[160, 120]} wait=${topic ? "Waiting for the first picture." : "No picture now."} onCar=${setPictured} />
        ${
          !error &&
          html`<div class="night-map"><${TrackMap} label=${`Map of the track with the car of ${everybody}`} height=${null}
          track=${lines} paths=${paths} cars=${cars.map((each) => ({ ...each, name: "" }))} objects=${objects} /></div>`
        }
      </div>`
    }`;
}

function Driver({ car, laps: most, began, live, here }) {
  const { racer, shown, laps, splits } = car;
  const times = laps.map((each) => [
    `Lap ${each.lap}`,
    each.progress >= 100 ? clock(each.time_s) + andResets(each.resets) : "not complete",
  ]);
  const thirds = SPLITS.map((_, k) => [
    `${k + 1}/3`,
    splits[k] === undefined ? "–" : number(splits[k], 2, "s"),
  ]);
  const seconds = Math.max(0, Date.now() / 1000 - began);
  const said = !live
    ? here && (shown || seconds > START_S)
      ? "The laps are driven; the result comes soon."
      : `Has driven for ${duration(seconds)}.`
    : shown
      ? `Lap ${Math.min(most, shown.laps + 1)} of ${most}, ${number(Math.max(0, shown.progress))} %, ${number(shown.lap_s, 1, "s")}${andResets(shown.resets)}`
      : "Goes to the start.";
  const share = shown && (100 * shown.laps + Math.max(0, shown.progress)) / most;
  return html`
    <div class="night-driver">
      <p class="night-driver-name">${racer}</p>
      ${shown && html`<progress max="100" value=${Math.min(100, share)} aria-label=${`Progress of ${racer}`}></progress>`}
      <p class="night-driver-facts">${said}</p>
      ${
        shown &&
        html`<dl class="night-splits" aria-label=${`Split times of ${racer}`}>
        ${[...times.slice(-3), ...thirds].map(([name, text]) => html`<div key=${name}><dt>${name}</dt><dd>${text}</dd></div>`)}
      </dl>`
      }
    </div>`;
}

function Next({ race }) {
  const { next: runs } = race;
  const most = isNarrow.value ? runs.length : race.moments.driving ? 2 : 4;
  return html`
    <section class="night-next" aria-label="Next">
      <h2>Next</h2>
      ${
        runs.length
          ? html`<ol>${runs.slice(0, most).map((name, k) => html`<li key=${race.queue[k]}>${name}</li>`)}</ol>`
          : html`<p class="quiet">The queue is empty${race.state === "open" ? ": submit a model." : "."}</p>`
      }
      ${runs.length > most && html`<p class="quiet">and ${number(runs.length - most)} more</p>`}
    </section>`;
}

/** A result that has come since the page was opened, for some seconds. */
function LastResult({ race }) {
  const run = race.moments.last;
  const known = useRef(run?.key);
  const [shown, setShown] = useState(null);
  useEffect(() => {
    if (!run || run.key === known.current) return undefined;
    known.current = run.key;
    setShown(run.key);
    const timer = setTimeout(() => setShown(null), LAST_MS);
    return () => clearTimeout(timer);
  }, [run?.key]);
  const here = run && shown === run.key;
  const places = here
    ? race.leaderboard.filter(
        (row) => row.rank && run.cars.some((car) => car.submission === row.submission),
      )
    : [];
  const result = (car) =>
    `${car.racer}: ${run.state === "failed" ? "the run has failed" : car.text}`;
  return html`
    <section class="night-last in" aria-live="polite" aria-label="Last result" hidden=${!here}>
      ${here && html`<p><strong>Last result  </strong>${run.cars.map(result).join("   ")}${places.length === 1 && html`<strong>   Rank ${places[0].rank}</strong>`}</p>`}
    </section>`;
}
