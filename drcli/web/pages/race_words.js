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

/** Rules by their names in requests, as the form calls them. */
export const LABELS = {
  name: "Name",
  world: "Track",
  reverse: "Opposite direction",
  race_type: "Kind of race",
  ranking: "What decides",
  pairing: "Who meets whom",
  max_laps: "Laps",
  min_laps: "Complete laps needed",
  average_laps: "Laps in the best average",
  off_track_penalty_s: "Penalty for leaving the track, seconds",
  collision_penalty_s: "Penalty for a collision, seconds",
  max_submissions: "Submissions of each racer",
  obstacles: "Obstacles",
  bots: "Bot cars",
  opens: "Opens",
  closes: "Closes",
  seed: "Seed",
  sensors: "Allowed sensors",
  racer: "Racer",
  prefix: "Model",
  checkpoint: "Checkpoint",
};
// What the terminal calls them, where that is not almost the same.
const NAMES = {
  "--laps": "max_laps",
  "--sensor": "sensors",
  "--type": "race_type",
  DR_WORLD_NAME: "world",
  DR_OA_NUMBER_OF_OBSTACLES: "obstacles",
  DR_H2B_NUMBER_OF_BOT_CARS: "bots",
};
const OPTION = /--[a-z]+(-[a-z]+)*|\bDR_[A-Z0-9_]+/g;
// Sentences that name no option.
/** @type {[RegExp, string][]} */
const SAID = [
  [/name of the race/, "name"],
  [/name of the racer|has submitted/, "racer"],
  [/^Checkpoint /, "checkpoint"],
  [/s3:|prefix of a model/, "prefix"],
];

/** The rule that an option of the terminal means, or "". */
function ruleOf(option) {
  const name = option.replace(/^--/, "").replaceAll("-", "_");
  return [NAMES[option], name, `${name}_s`].find((key) => LABELS[key]) ?? "";
}

/** A sentence in the words of the page: its fields instead of options. */
export const inPage = (text) =>
  (text ?? "").replace(OPTION, (option) =>
    ruleOf(option) ? `“${LABELS[ruleOf(option)]}”` : option,
  );

/** An error of the server in the words of the page, and the field that it is about. */
export function aboutField({ message, remedy = "" }) {
  const said = SAID.find(([pattern]) => pattern.test(message))?.[1];
  const options = `${message} ${remedy}`.match(OPTION) ?? [];
  const key = said ?? options.map(ruleOf).find(Boolean) ?? "";
  return { severity: "error", key, message: inPage(message), remedy: inPage(remedy) };
}
