// What the server says, for components: topics of the WebSocket, answers to requests, actions.

import { get } from "/api.js";
import { notify } from "/notices.js";
import { follow, followRows } from "/socket.js";
import { Button, html, signal, useEffect, useRef, useState } from "/ui.js";

/** Where the page is: path and query of the part of the address after #. */
export const route = signal(readRoute());

function readRoute() {
  const [path, query = ""] = (location.hash.slice(1) || "/").split("?");
  return { path, query: new URLSearchParams(query) };
}
// Pages change the query themselves, without a step of the history: `setQuery`.
addEventListener("hashchange", () => {
  route.value = readRoute();
});

/**
 * Keep a choice in the address, so that Back, a reload and a bookmark have it, too.
 * @param {Record<string, string>} changes of the query; "" leaves a name out
 * @param {boolean} step whether Back takes it back
 */
export function setQuery(changes, step = false) {
  const { path, query } = readRoute();
  for (const [name, value] of Object.entries(changes)) {
    if (value) query.set(name, value);
    else query.delete(name);
  }
  const text = query.toString();
  const address = `#${path}${text ? `?${text}` : ""}`;
  if (step) history.pushState(null, "", address);
  else history.replaceState(history.state, "", address);
  route.value = { path, query };
}

/** A signal that is aborted when a component goes, or one of these values changes. */
function useWhile(begin, values) {
  useEffect(() => {
    const own = new AbortController();
    begin(own.signal);
    return () => own.abort();
  }, values);
}

function useFollowed(how, topic) {
  const [state, setState] = useState({ topic, value: null, error: null });
  useWhile(
    (signal) => {
      const listener = (value, error) =>
        setState((before) => {
          const stays = error && before.topic === topic;
          return { topic, value: stays ? before.value : value, error };
        });
      if (topic) how(topic, listener, signal);
    },
    [topic],
  );
  return state.topic === topic ? state : { topic, value: null, error: null };
}

/**
 * The newest value of a topic: null before the first, the last good one beside an error.
 * @param {string | null} topic null for none
 * @param {number} every milliseconds between two values that are taken; those in between are left out
 * @returns {{value: any, error: any}}
 */
export const useTopic = (topic, every = 0) =>
  useFollowed((name, listener, signal) => {
    let [at, timer] = [0, 0];
    const take = (data) => {
      at = Date.now();
      if (!signal.aborted) listener(data.error ? null : data, data.error ?? null);
    };
    follow(
      name,
      (data) => {
        clearTimeout(timer);
        const wait = at + every - Date.now();
        // One that comes too soon is taken if no other follows: what others have drawn by then is one picture.
        if (wait > 0 && !data.error) timer = setTimeout(take, wait + every, data);
        else take(data);
      },
      signal,
    );
  }, topic);

/**
 * All rows of a growing topic.
 * @param {string | null} topic
 * @returns {{value: any[] | null, error: any}}
 */
export const useRows = (topic) => useFollowed(followRows, topic);

/**
 * The answer to a request; `reload` asks again, and so does another version of what is asked for.
 * @param {string | null} path null to wait
 * @param {any} version
 * @returns {{value: any, error: any, reload: () => void}}
 */
export function useGet(path, version = null) {
  const [asked, setAsked] = useState(0);
  const [state, setState] = useState({ path: null, value: null, error: null });
  useWhile(
    (signal) => {
      if (path)
        get(path, signal).then(
          (value) => setState({ path, value, error: null }),
          (error) => error.name !== "AbortError" && setState({ path, value: null, error }),
        );
      // What is asked for again later is not known until then.
      else setState({ path: null, value: null, error: null });
    },
    [path, asked, version],
  );
  const { value, error } = path && state.path === path ? state : { value: null, error: null };
  return { value, error, reload: () => setAsked((times) => times + 1) };
}

/**
 * Something that takes a while: it is not begun twice, and says itself what went wrong.
 * @param {(...given: any[]) => Promise<any>} action
 * @returns {[(...given: any[]) => Promise<any>, boolean]} the action, and whether it runs
 */
export function useAction(action) {
  const [busy, setBusy] = useState(false);
  const running = useRef(false);
  const run = async (...given) => {
    if (running.current) return null;
    running.current = true;
    setBusy(true);
    try {
      return await action(...given);
    } catch (error) {
      // A task that failed has its own notice.
      if (error.name !== "AbortError" && !error.ofTask) notify(error.message, "bad", error.remedy);
      return null;
    } finally {
      running.current = false;
      setBusy(false);
    }
  };
  return [run, busy];
}

/** A button whose action takes a while, and says itself what went wrong. */
export function Act({ action, text, ...more }) {
  const [run, busy] = useAction(action);
  return html`<${Button} busy=${busy} onClick=${() => run()} ...${more}>${text}<//>`;
}
