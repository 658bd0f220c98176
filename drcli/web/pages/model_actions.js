// What can be done with a model: train on, evaluate, clone, submit, download, upload, film, delete. The server asks first.

import { api, get, post } from "/api.js";
import { ask } from "/ask.js";
import { Diff } from "/model_files.js";
import { runTask, save, taskEnd } from "/model_tasks.js";
import { notify } from "/notices.js";
import { setQuery } from "/store.js";
import { html } from "/ui.js";

const Intro = ({ intro = "", diffs = [] }) => html`
  ${intro && html`<p>${intro}</p>`}
  ${diffs.map(({ summary, lines }) => html`<details key=${summary}><summary>${summary}</summary><${Diff} lines=${lines} /></details>`)}`;

/** What follows an action: its answer or the result of its task, and what was asked for. */
const AFTER = {
  start: ({ ends }) => notify(ends),
  clone({ after, file }, { prefix, take }) {
    const changed = [file, ...take].join(", ");
    notify(
      `Your next training is ${after}; it begins with the weights of ${prefix}. ${changed} was changed.`,
    );
    location.hash = "#/new";
  },
  submit(_, { race }) {
    location.hash = `#/race/${encodeURIComponent(race)}`;
  },
  download(made) {
    for (const problem of made.report?.problems ?? [])
      notify(problem.message ?? String(problem), "warn");
    save(made);
  },
  upload: ({ checkpoint, target }) => notify(`${checkpoint} is at ${target}.`),
  film: (made) => made.url && save(made),
  delete() {
    location.hash = "#/models";
  },
};

export const stopEvaluation = (prefix) => () => runTask("/api/model/stop-evaluation", { prefix });

/**
 * The actions of a model by their names; each rejects with what went wrong, and does nothing where its question is left.
 * @param {string} prefix
 * @returns {(name: string, given?: Object) => () => Promise<void>} given: what the question is about, such as a checkpoint
 */
export const modelActions =
  (prefix) =>
  (name, given = {}) =>
  async () => {
    const query = new URLSearchParams({ prefix, about: name, ...given });
    const { intro, diffs, ...question } = await get(`/api/model/question?${query}`);
    let body;
    const answer = await ask({
      ...question,
      about: [prefix, ...Object.values(given)].join(" "),
      intro: html`<${Intro} intro=${intro} diffs=${diffs} />`,
      send: (values) => {
        body = { prefix, take: [], ...given, ...values };
        return post(name === "submit" ? api("race", body.race, name) : `/api/model/${name}`, body);
      },
    });
    if (!answer) return;
    if (name === "evaluate") setQuery({ tab: "evaluations" }, true);
    const made = answer.task ? await taskEnd(answer.task) : answer;
    for (const sentence of made?.warnings ?? []) notify(sentence, "warn");
    AFTER[name]?.(made, body);
  };
