// What is seen of a worker while it drives: pictures, the track, and the lines of its cars.

import { get } from "/api.js";
import { follow } from "/socket.js";
import { number } from "/text.js";
import { html, signal, useEffect, useRef, useSeen, useState } from "/ui.js";

const TRAIL_POINTS = 400;
const MOST_TRAILS = 8;

export const pageSeen = signal(!document.hidden);
document.addEventListener("visibilitychange", () => {
  pageSeen.value = !document.hidden;
});

const tracks = new Map();
/** The lines of a track, read once; without them, `error` says why. */
export function useTrack(world) {
  const [state, setState] = useState({ world: null, lines: null, error: null });
  useEffect(() => {
    if (!world) return;
    if (!tracks.has(world)) tracks.set(world, get(`/api/track?world=${encodeURIComponent(world)}`));
    tracks.get(world).then(
      (lines) => setState({ world, lines, error: null }),
      (error) => {
        tracks.delete(world);
        setState({ world, lines: null, error });
      },
    );
  }, [world]);
  return state.world === world ? state : { lines: null, error: null };
}

const CAPTION_MS = 450; // pictures come faster than anybody reads

/**
 * A picture of a worker that is replaced by each newer one; its size never changes.
 * @param {{topic: string | null, name: string, label: string, size: number[], wait: string, car?: number | null, onCar?: (car: number | null) => void}} props
 *   `car`: pictures of another one are not shown; `onCar` hears whose picture is.
 */
export function LivePicture({ topic: wanted, name, label, size, wait, car, onCar = () => {} }) {
  const [width, height] = size;
  const [seen, setSeen] = useState(false);
  const figure = useSeen(setSeen);
  const topic = seen ? wanted : null; // what is scrolled away is neither sent nor decoded
  const canvas = useRef(null);
  const [told, setTold] = useState(null);
  useEffect(() => {
    if (!topic) {
      if (!wanted) setTold(null);
      return undefined;
    }
    const own = new AbortController();
    let last = { car: undefined, at: 0 };
    const take = ({ facts, picture }) => {
      if (!picture) return;
      const place = canvas.current;
      if (place.width !== picture.width)
        Object.assign(place, { width: picture.width, height: picture.height });
      place.getContext("2d").drawImage(picture, 0, 0);
      const [now, whose] = [Date.now(), facts.car ?? null];
      const age = now - 1000 * facts.step_s;
      Object.assign(place.dataset, { ageMs: age.toFixed(1), stepS: facts.step_s });
      if (whose === last.car && now - last.at < CAPTION_MS) return;
      last = { car: whose, at: now };
      setTold({ car: whose, age });
      onCar(whose);
    };
    follow(topic, take, own.signal);
    return () => own.abort();
  }, [topic, wanted]);
  const other = told && (car ?? null) !== null && told.car !== car;
  const after = told && (told.age < 10000 ? number(told.age, 0, "ms") : "more than 10 s");
  return html`
    <figure class="live-picture" ref=${figure}>
      <div class="live-frame" style=${{ aspectRatio: `${width} / ${height}` }}>
        <canvas ref=${canvas} role="img" aria-label=${label} width=${width} height=${height}></canvas>
        ${(!told || other) && html`<p class="live-over">${other ? "The picture of this car comes soon." : wait}</p>`}
      </div>
      <figcaption>${name}${told && !other && `${told.car === null ? "" : `, car ${told.car + 1}`}, ${after} after its step`}</figcaption>
    </figure>`;
}

/** Lines of an evaluation as they come: its trace is written at its end. */
export function addTrails(trails, cars, colorOf) {
  for (const each of cars) {
    const key = `${each.car}.${each.episode}.${each.laps}`;
    if (!trails.has(key)) {
      trails.set(key, { x: [], y: [], color: colorOf(each) });
      for (const old of [...trails.keys()].slice(0, -MOST_TRAILS)) trails.delete(old);
    }
    const line = trails.get(key);
    line.x = [...line.x, each.x].slice(-TRAIL_POINTS);
    line.y = [...line.y, each.y].slice(-TRAIL_POINTS);
  }
  return [...trails.values()]
    .reverse()
    .map((line, k) => ({ ...line, alpha: Math.max(0.15, 0.9 - 0.12 * k) }));
}
