// The one WebSocket: topics in, values out. It is opened again by itself.

import { signal } from "/vendor/preact/preact.js";

const listeners = new Map(); // topic -> Set of functions
const newest = new Map(); // topic -> last value, for a second listener of the same topic
/** Whether the connection is open. */
export const connected = signal(false);
const GATHER_MS = 30;
let socket = null,
  wait = 250,
  timer = 0,
  heard = 0;

// The server says something at least every 15 s. A connection through a tunnel can end without a word.
const SILENCE_MS = 45000;

/** Follow a topic until the signal aborts. Text topics give their data, pictures `{facts, picture}`, which is closed afterwards. */
export function follow(topic, listener, signal) {
  if (signal?.aborted) return;
  if (!listeners.has(topic)) listeners.set(topic, new Set());
  listeners.get(topic).add(listener);
  if (newest.has(topic)) listener(newest.get(topic));
  signal?.addEventListener(
    "abort",
    () => {
      const all = listeners.get(topic);
      all?.delete(listener);
      if (all && !all.size) {
        listeners.delete(topic);
        newest.delete(topic);
      }
      watch();
    },
    { once: true },
  );
  watch();
}

/** Rows of a growing topic: calls the listener with the whole list after every change. */
export function followRows(topic, listener, signal) {
  let rows = [];
  follow(
    topic,
    (data) => {
      if (data.error) return listener(rows, data.error);
      rows = rows.slice(0, data.start).concat(data.rows);
      newest.set(topic, { start: 0, rows });
      listener(rows, null);
    },
    signal,
  );
}

let scheduled = false;
function watch() {
  if (scheduled) return;
  scheduled = true;
  queueMicrotask(() => {
    scheduled = false;
    if (socket?.readyState === WebSocket.OPEN)
      socket.send(JSON.stringify({ watch: [...listeners.keys()] }));
  });
}

function connect() {
  clearTimeout(timer);
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const mine = (socket = new WebSocket(`${scheme}://${location.host}/ws`));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => {
    wait = 250;
    heard = Date.now();
    newest.clear();
    connected.value = true;
    watch();
  };
  socket.onmessage = ({ data }) => {
    heard = Date.now();
    if (typeof data === "string") text(data);
    else picture(data);
  };
  socket.onclose = () => {
    if (mine === socket) again();
  };
}

function again() {
  socket = null;
  connected.value = false;
  clearTimeout(timer);
  timer = setTimeout(connect, wait * (0.75 + Math.random() / 2));
  wait = Math.min(wait * 2, 5000);
}

setInterval(() => {
  if (!connected.value || Date.now() - heard < SILENCE_MS) return;
  const silent = socket;
  again();
  silent.close();
}, 5000);

// What comes together is drawn together: each picture of the page costs more than the values in it.
let waiting = [];
let handed = Promise.resolve();
function give(topic, value) {
  if (waiting.push([topic, value]) > 1) return;
  setTimeout(() => (handed = handed.then(hand).catch(reportError)), GATHER_MS);
}

async function hand() {
  const all = waiting;
  waiting = [];
  for (const [, value] of all) if (value?.picture) value.picture = await value.picture;
  for (const [topic, value] of all) {
    if (listeners.has(topic) && !value?.picture) newest.set(topic, value);
    for (const listener of [...(listeners.get(topic) ?? [])]) {
      try {
        listener(value);
      } catch (error) {
        reportError(error); // the others get what is theirs
      }
    }
    value?.picture?.close();
  }
}

function text(data) {
  const message = JSON.parse(data);
  give(message.topic, message.data);
}

function picture(buffer) {
  const length = new DataView(buffer).getUint16(0);
  const facts = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 2, length)));
  const blob = new Blob([new Uint8Array(buffer, 2 + length)], { type: "image/jpeg" });
  // A damaged one is null; the next one comes soon.
  give(facts.topic, { facts, picture: createImageBitmap(blob).catch(() => null) });
}

// A machine that was asleep, or a page that was in the background, is connected again at once.
function hurry() {
  if (socket === null) {
    wait = 250;
    connect();
  }
}
addEventListener("online", hurry);
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) hurry();
});
connect();
