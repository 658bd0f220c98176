// Words and links that the pages about races share.

import { api } from "/api.js";
import { moment, number } from "/text.js";
import { html } from "/ui.js";

export const raceLink = (race) => `#/race/${encodeURIComponent(race)}`;
export const nightLink = (race) => `#/night/${encodeURIComponent(race)}`;
export const racePath = (race, ...parts) => api("race", race, ...parts);

/** Address of a video from its key in the bucket. */
export function videoPath(race, key, download = false) {
  const name = key
    .split("/")
    .at(-1)
    .replace(/\.mp4$/, "");
  return `${racePath(race, "video")}?name=${encodeURIComponent(name)}${download ? "&download" : ""}`;
}

export const OBJECT_SETTINGS = { OBJECT_AVOIDANCE: "DR_OA_", HEAD_TO_BOT: "DR_H2B_" };
/** For a page that prepares a training. */
export const KIND_NOTES = {
  OBJECT_AVOIDANCE: 'The template "object avoidance" of the reward function is made for this race.',
  HEAD_TO_BOT: 'The template "head to bot" of the reward function is made for this race.',
  HEAD_TO_MODEL:
    "Two trained models race; it is for evaluations only. Choose another race to train.",
};

const STATES = {
  scheduled: ["Not open yet", "warn"],
  open: ["Open", "good"],
  closed: ["Closed", "warn"],
  finished: ["Finished", ""],
};

/** Whether a race takes submissions, as a label. */
export function StateBadge({ state }) {
  const [text, kind] = STATES[state] ?? [state, ""];
  return html`<span class=${`race-badge ${kind}`}>${text}</span>`;
}

/** Seconds behind the first. */
export function gapText({ rank, gap_s: gap }) {
  if (rank === null) return "not qualified";
  return gap === null ? "–" : rank === 1 ? "" : `+${number(gap, 3, "s")}`;
}

/** Points of a race in pairs. */
export const pointsText = ({ points }) => number(points ?? 0, points % 1 ? 1 : 0);

/** "1 run waits", "3 runs wait". */
export const waitText = (count) => (count === 1 ? "1 run waits" : `${number(count)} runs wait`);

/** A date of a record as this machine writes dates. */
export const dateText = (text) => moment(Date.parse(text) / 1000);

export const checkpointNumber = ({ checkpoint }) => checkpoint.split("_")[0];

export const inPairs = ({ rules }) => rules.race_type === "HEAD_TO_MODEL";

/** "Ann against Bob" */
export const driversText = ({ cars }) => cars.map((car) => car.racer).join(" against ");

/** What the server refuses, and the field of a form that it is about. */
export const aboutField = ({ message, remedy = "", problems = [] }) => ({
  ...{ severity: "error", key: "", message, remedy },
  ...problems[0],
});
