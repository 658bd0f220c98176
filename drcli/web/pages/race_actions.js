// What organisers and racers are asked before something is done with a race, and what they keep and watch of it.

import { get, getBlob, post } from "/api.js";
import { ask } from "/ask.js";
import { show } from "/dialogs.js";
import { saveBlob } from "/model_tasks.js";
import { racePath, videoPath } from "/race_words.js";
import { html, useState } from "/ui.js";

const question = (id, about, given = {}) =>
  get(`${racePath(id, "question")}?${new URLSearchParams({ about, ...given })}`);

/**
 * Ask what the server asks before something is done with a race, and do it.
 * @param {string} id
 * @param {string} about
 * @param {Object} given what it is about
 * @param {(body: Object) => Promise<any>} send
 */
export const asked = async (id, about, given, send) =>
  ask({
    ...(await question(id, about, given)),
    send: (values) => send({ ...given, ...values }),
  });

/** Ask which checkpoint of which model is submitted by whom. @returns {Promise<Object | null>} the answer of the server */
export async function submitted(id) {
  const fields = async (prefix) => (await question(id, "submit", { prefix })).fields;
  const send = (values) => post(racePath(id, "submit"), values);
  return ask({ ...(await question(id, "submit")), again: { name: "prefix", fields }, send });
}

/** Let the browser keep a file of the race; errors are those of the server. */
export const keep = async (id, path, name) =>
  saveBlob(await getBlob(`${racePath(id)}/${path}`), name);

export async function showLog(id) {
  const { path, text } = await get(racePath(id, "log"));
  const log = html`
    <p class="quiet">${text === null ? "This machine has not driven the queue of this race in the background yet." : `The end of ${path}`}</p>
    ${text !== null && html`<pre class="race-log" tabindex="0">${text}</pre>`}`;
  await show("Log of the queue", log);
}

function Film({ id, video, name }) {
  const [broken, setBroken] = useState(false);
  return html`
    <video controls autoplay muted playsinline src=${videoPath(id, video)} aria-label=${`Video: ${name}`} onError=${() => setBroken(true)}></video>
    ${broken && html`<p class="problem">This video cannot be played here. Save it, and open it with another player.</p>`}
    <p><a class="button" href=${videoPath(id, video, true)} download="">Save the video</a></p>`;
}

export const watch = (id, video, name) =>
  show(name, html`<${Film} id=${id} video=${video} name=${name} />`);
