// Words and links that the pages about races share.

import { api, ApiError } from "/api.js";
import { h, number } from "/dom.js";

export const raceLink = (race) => `#/race/${encodeURIComponent(race)}`;
export const nightLink = (race) => `#/night/${encodeURIComponent(race)}`;
export const racePath = (race, ...parts) => api("race", race, ...parts);

/** Address of a video from its key in the bucket. */
export const videoPath = (race, key, download = false) =>
  `${racePath(race, "video")}?name=${encodeURIComponent(
    key
      .split("/")
      .at(-1)
      .replace(/\.mp4$/, ""),
  )}${download ? "&download" : ""}`;

export const KINDS = {
  TIME_TRIAL: "Time trial",
  OBJECT_AVOIDANCE: "Object avoidance",
  HEAD_TO_BOT: "Head to bot",
  HEAD_TO_MODEL: "Head to head, in pairs",
};
export const OBJECT_SETTINGS = { OBJECT_AVOIDANCE: "DR_OA_", HEAD_TO_BOT: "DR_H2B_" };
/** For a page that prepares a training. */
export const KIND_NOTES = {
  OBJECT_AVOIDANCE: 'The template "object avoidance" of the reward function is made for this race.',
  HEAD_TO_BOT: 'The template "head to bot" of the reward function is made for this race.',
  HEAD_TO_MODEL:
    "Two trained models race; it is for evaluations only. Choose another race to train.",
};
export const RANKINGS = {
  "best-lap": "Best lap",
  "best-average": "Best average of laps in a row",
  "total-time": "Total time of all laps",
};
export const PAIRINGS = {
  "round-robin": "Round robin: everybody meets everybody once",
  bracket: "Bracket: the winners go on",
};

const STATES = {
  scheduled: ["Not open yet", "warn"],
  open: ["Open", "good"],
  closed: ["Closed", "warn"],
  finished: ["Finished", ""],
};

/** Whether a race takes submissions, as a label. */
export function stateBadge(state) {
  const [text, kind] = STATES[state] ?? [state, ""];
  return h("span", { class: `race-badge ${kind}` }, text);
}

/** Seconds behind the first. */
export const gapText = (row) =>
  row.gap_s === null ? "–" : row.rank === 1 ? "" : `+${number(row.gap_s, 3, "s")}`;

export const rankText = (row) => (row.rank === null ? "not qualified" : String(row.rank));

/** The laps of a submission: times with penalties and resets, and how the others ended. */
export const lapsText = (entry) => entry.lap_text.join("; ");

/** "1 run waits", "3 runs wait". */
export const waitText = (count) => (count === 1 ? "1 run waits" : `${number(count)} runs wait`);

/** A date of a record as this machine writes dates. */
export const dateText = (text) =>
  new Date(text).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" });

/** Fetch a file of the console and let the browser keep it; errors are those of the server. */
export async function keepFile(path, name) {
  let answer;
  try {
    answer = await fetch(path);
  } catch {
    throw new ApiError(0, {
      message: "The console does not answer.",
      remedy: "Start it with `dr console start`.",
    });
  }
  if (!answer.ok) {
    const value = await answer.json().catch(() => null);
    throw new ApiError(
      answer.status,
      value?.error ?? { message: `The console answered ${answer.status}.` },
    );
  }
  const url = URL.createObjectURL(await answer.blob());
  const link = h("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}
