// Starts a task of the server, and waits for its end; app.js shows its progress and its failure.

import { ApiError, post } from "/api.js";
import { notify } from "/notices.js";
import { follow } from "/socket.js";

/** The result of a task by its number; rejects with its error. */
export function taskEnd(number, signal) {
  return new Promise((resolve, reject) => {
    const own = new AbortController();
    signal?.addEventListener(
      "abort",
      () => {
        own.abort();
        reject(new DOMException("The page was left.", "AbortError"));
      },
      { once: true },
    );
    follow(
      "tasks",
      ({ tasks = [] }) => {
        const task = tasks.find((each) => each.id === number);
        if (!task || task.ended === null || own.signal.aborted) return;
        own.abort();
        if (task.state === "failed")
          reject(Object.assign(new ApiError(0, task.error), { ofTask: true }));
        else resolve(task.result);
      },
      own.signal,
    );
  });
}

/** Start a task of the server, and wait for its result. */
export async function runTask(path, body, signal) {
  const { task } = await post(path, body);
  return taskEnd(task, signal);
}

const KEPT_MS = 60_000;

/** Let the browser keep what a page has. */
export function saveBlob(blob, name) {
  const url = URL.createObjectURL(blob);
  save({ url, name });
  setTimeout(() => URL.revokeObjectURL(url), KEPT_MS);
}

/** Let the browser keep a file that a task has made. */
export function save({ url, name }) {
  const link = Object.assign(document.createElement("a"), { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  notify(`${name} is being downloaded.`);
}
