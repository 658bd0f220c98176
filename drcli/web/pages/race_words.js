// Words and links that the pages about races share.

import { api } from "/api.js";
import { moment, number } from "/text.js";
import { html } from "/ui.js";

export const raceLink = (race) => `#/race/${encodeURIComponent(race)}`;
export const nightLink = (race) => `#/night/${encodeURIComponent(race)}`;
export const racePath = (race, ...parts) => api("race", race, ...parts);

/** Address of a video from its key in the bucket. */
export function videoPath(race, key, download = false) {
  const [, name] = /([^/]+)\.mp4$/.exec(key);
  return `${racePath(race, "video")}?name=${encodeURIComponent(name)}${download ? "&download" : ""}`;
}

/** Whether a race takes submissions, as a label. */
export const StateBadge = ({ badge: [text, kind] }) =>
  html`<span class=${`race-badge ${kind}`}>${text}</span>`;

/** "1 run waits", "3 runs wait". */
export const waitText = (count) => (count === 1 ? "1 run waits" : `${number(count)} runs wait`);

/** A date of a record as this machine writes dates. */
export const dateText = (text) => moment(Date.parse(text) / 1000);

export const checkpointNumber = ({ checkpoint }) => checkpoint.split("_")[0];

export const inPairs = ({ rules }) => rules.race_type === "HEAD_TO_MODEL";

/** "Ann against Bob" */
export const driversText = ({ cars }) => cars.map((car) => car.racer).join(" against ");
