// A stored episode on the page: its columns at once, pictures and choices in windows when they are needed.

import { get, getPacked } from "/api.js";
import { useGet } from "/store.js";
import { signal as changes, useEffect, useMemo } from "/ui.js";

const WINDOW = 64;
const EXPLAINED = 16;
const MOST_WINDOWS = 60; // of pictures: about 12 MB
const MOST_CURVE = 3000; // rows whose choices are fetched before they are looked at, for the curve of the critic

/** The path of a request of the player. @param {string} name @param {Record<string, any>} query */
export const playPath = (name, query = {}) => `/api/play/${name}?${new URLSearchParams(query)}`;

/**
 * A stored episode.
 * @param {{model: string, trace: string, episode: string} | null} query
 * @returns {{data: EpisodeData | null, error: any, again: () => void}}
 */
export function useLap(query) {
  const opened = useGet(query && playPath("open", { model: query.model, trace: query.trace }));
  const lap = useGet(query && opened.value && playPath("lap", query));
  const data = useMemo(
    () => (opened.value && lap.value ? new EpisodeData(query, opened.value, lap.value) : null),
    [opened.value, lap.value],
  );
  useEffect(() => () => data?.close(), [data]);
  const failed = [opened, lap].find((each) => each.error);
  return { data, error: failed?.error, again: failed?.reload };
}

/** One episode; components that ask it are drawn again when its answer may be another one. */
export class EpisodeData {
  constructor(query, facts, lap) {
    this.query = query;
    this.facts = facts;
    this.lap = lap;
    this.requests = new AbortController();
    this.signal = this.requests.signal;
    /** Changes when more of the episode is there, or it is looked at in another way. */
    this.version = changes(0);
    this.rows = lap.time_s.length;
    this.checkpoint = facts.policy.available.includes(facts.policy.checkpoint)
      ? facts.policy.checkpoint
      : null;
    this.explains = false;
    this.problem = null; // of the pictures
    this.policyProblem = null;
    this.parts = { steps: new Map(), policy: new Map(), explained: new Map() };
    this.wanted = 0;
    this.busy = false;
    const known = new Set(facts.used_parameters);
    this.isUsed = (name) => known.has(name);
    this.progress = rising(lap.progress);
  }

  /** Nobody looks at it any more. */
  close() {
    this.requests.abort();
  }

  /** Fetch what the row needs, then what comes next. */
  want(row) {
    this.wanted = row;
    this.#next();
  }

  /** Look with another checkpoint; null for none. */
  look(checkpoint) {
    this.checkpoint = checkpoint;
    this.policyProblem = null;
    this.parts.policy.clear();
    this.parts.explained.clear();
    this.#begin();
  }

  /** Show the explanation map or not. */
  explain(on) {
    this.explains = on;
    this.#begin();
  }

  /** Forget what failed, and try again. */
  retry() {
    this.problem = this.policyProblem = null;
    this.#begin();
  }

  #begin() {
    this.version.value += 1;
    this.#next();
  }

  /** Picture of a row as a blob, with the map over it if that is wanted and there. */
  picture(row) {
    const explained =
      this.explains && this.checkpoint !== null
        ? this.#part("explained", row)?.pictures[row % EXPLAINED]
        : null;
    return {
      blob: explained ?? this.#part("steps", row)?.pictures[row % WINDOW] ?? null,
      explained: Boolean(explained),
    };
  }

  /** Reward parameters of a row: columns of its window and the row in them; null while they are not there. */
  parameters(row) {
    const part = this.#part("steps", row);
    return part?.facts.parameters ? { ...part.facts.parameters, at: row % WINDOW } : null;
  }

  /** What the policy makes of the picture of a row: its answer and the row in it. */
  choice(row) {
    const part = this.#part("policy", row);
    return part ? { ...part, at: row % WINDOW } : null;
  }

  /** What the critic expects at every row; null where it is not known yet. */
  values() {
    const found = new Array(this.rows).fill(null);
    for (const part of this.parts.policy.values())
      part.value?.forEach((value, k) => {
        found[part.first + k] = value;
      });
    return found;
  }

  #part(kind, row) {
    if (this.version.value < 0) return undefined; // reading it is what makes a component follow it
    return this.parts[kind].get(Math.floor(row / (kind === "explained" ? EXPLAINED : WINDOW)));
  }

  /** What is to be fetched next: [kind, number of the window]; null if nothing is missing. */
  #missing() {
    const here = Math.floor(this.wanted / WINDOW),
      last = Math.floor((this.rows - 1) / WINDOW);
    const looks = this.checkpoint !== null && this.facts.outline && !this.policyProblem;
    const draws = this.facts.outline && !this.problem;
    const list = [];
    if (draws) list.push(["steps", here]);
    if (looks) list.push(["policy", here]);
    if (looks && this.explains) {
      const place = Math.floor(this.wanted / EXPLAINED);
      list.push(["explained", place]);
      if ((place + 1) * EXPLAINED < this.rows) list.push(["explained", place + 1]);
    }
    if (draws && here < last) list.push(["steps", here + 1]);
    if (looks && here < last) list.push(["policy", here + 1]);
    if (looks)
      for (let k = 0; k <= last && k * WINDOW < MOST_CURVE; k += 1) list.push(["policy", k]);
    return list.find(([kind, place]) => !this.parts[kind].has(place)) ?? null;
  }

  async #next() {
    if (this.busy || this.signal.aborted) return;
    const missing = this.#missing();
    if (!missing) return;
    const [kind, place] = missing,
      size = kind === "explained" ? EXPLAINED : WINDOW,
      checkpoint = this.checkpoint;
    const query = { ...this.query, first: place * size, count: size };
    this.busy = true;
    try {
      const read = kind === "policy" ? get : getPacked;
      const looks = kind === "steps" ? query : { ...query, checkpoint };
      const part = await read(playPath(kind, looks), this.signal);
      if (kind === "steps" || checkpoint === this.checkpoint) this.#keep(kind, place, part);
    } catch (error) {
      if (this.signal.aborted || error.name === "AbortError") return;
      if (kind === "steps") this.problem = error;
      else if (checkpoint === this.checkpoint) this.policyProblem = error;
    } finally {
      this.busy = false;
    }
    if (this.signal.aborted) return;
    this.version.value += 1;
    this.#next();
  }

  #keep(kind, place, part) {
    const parts = this.parts[kind];
    parts.set(place, part);
    if (kind === "policy") return; // numbers only
    for (const old of parts.keys()) {
      if (parts.size <= MOST_WINDOWS) break;
      parts.delete(old);
    }
  }
}

function rising(values) {
  let most = -Infinity;
  return values.map((value) => (most = Math.max(most, value)));
}
