// The form with all rules of a race, to make one or to change one. What it comes to is checked while it is filled.

import { Field, SelectField, TextField, leadTo, useChecked } from "/fields.js";
import { KINDS, LABELS, aboutField } from "/race_words.js";
import { DraftNote } from "/steps.js";
import { useAction, useGet } from "/store.js";
import { Button, Failure, Prose, html, useEffect, useRef, useState } from "/ui.js";

const CHECK_MS = 350;
const SLOW_MS = 2000;
const CHOICES = {
  race_type: KINDS,
  ranking: {
    "best-lap": "Best lap",
    "best-average": "Best average of laps in a row",
    "total-time": "Total time of all laps",
  },
  pairing: {
    "round-robin": "Round robin: everybody meets everybody once",
    bracket: "Bracket: the winners go on",
  },
};
const HELP = {
  name: "What racers see, such as Friday Cup.",
  max_laps: "Each submission drives this many, one after the other.",
  min_laps:
    "A submission with fewer complete laps is not ranked. Empty: 1 for the best lap, all for the total time.",
  average_laps: "Complete laps in a row. Empty: 3, or all if there are fewer.",
  max_submissions: "0 for any number. Empty: 1 in pairs, else any number.",
  opens: "Empty: at once.",
  closes: "Empty: stays open until somebody closes it.",
  seed: "All submissions drive with this seed. Empty: a random one.",
  obstacles: "Boxes on the track. Empty: as in the settings.",
  bots: "Cars that drive at a constant speed. Empty: as in the settings.",
};
const PARTS = {
  Race: ["name", "world", "race_type", "obstacles", "bots"],
  "What decides": [
    "ranking",
    "pairing",
    "max_laps",
    "min_laps",
    "average_laps",
    "off_track_penalty_s",
    "collision_penalty_s",
  ],
  "Who and when": ["max_submissions", "opens", "closes", "seed"],
};
const TIMES = ["opens", "closes"];
const TEXTS = ["name", "world", ...Object.keys(CHOICES)];
const NUMBERS = Object.values(PARTS)
  .flat()
  .filter((key) => !TIMES.includes(key) && !TEXTS.includes(key));

const PAIRED = ["ranking", "min_laps", "average_laps"];
/** Whether a rule has no meaning for this kind of race. */
const isHidden = (key, kind) =>
  (key === "obstacles" && kind !== "OBJECT_AVOIDANCE") ||
  (key === "bots" && kind !== "HEAD_TO_BOT") ||
  (key === "pairing" && kind !== "HEAD_TO_MODEL") ||
  (PAIRED.includes(key) && kind === "HEAD_TO_MODEL");

function localTime(unix) {
  if (!unix) return "";
  const at = new Date(unix * 1000);
  return new Date(Number(at) - at.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
}

/** What the form begins with: the present rules, or the usual ones. */
function startOf(usual, wish) {
  const start = {
    ...{ world: usual.world, race_type: "TIME_TRIAL", ranking: "best-lap", pairing: "round-robin" },
    ...{ max_laps: 3, reverse: false, sensors: [], off_track_penalty_s: usual.off_track_penalty_s },
    ...{ collision_penalty_s: usual.collision_penalty_s, name: "", ...wish },
    ...{ opens: localTime(wish?.opens_at), closes: localTime(wish?.closes_at) },
  };
  for (const key of NUMBERS) start[key] = String(start[key] ?? "");
  return start;
}

/** The rules as the server takes them, and what no server needs to say about them. */
function rulesOf(values) {
  const rules = { reverse: values.reverse, sensors: values.sensors };
  const wrong = [];
  for (const key of TEXTS) rules[key] = values[key];
  for (const key of TIMES) rules[key] = values[key] ? new Date(values[key]).toISOString() : "";
  for (const key of NUMBERS) {
    const text = isHidden(key, values.race_type) ? "" : values[key].trim();
    const seconds = key.endsWith("_s");
    rules[key] = text === "" ? null : Number(text);
    if (seconds ? Number.isFinite(rules[key]) : Number.isSafeInteger(rules[key] ?? 0)) continue;
    wrong.push({
      severity: "error",
      key,
      message: `“${LABELS[key]}” is not a ${seconds ? "" : "whole "}number.`,
      remedy: `Write digits, such as ${seconds ? "2.5" : "3"}.`,
    });
  }
  return { rules, wrong };
}

/**
 * @param {{title: string, action: string, draft: Object, wish?: Object, send: (rules: Object) => Promise<void>, leave: () => void}} props
 *   wish: the present rules of a race
 */
export function RaceForm(props) {
  const { value: usual, error } = useGet("/api/races/form");
  const { title, draft } = props;
  return html`
    <section class="race-card" aria-label=${title}>
      <h2>${title}</h2>
      ${props.wish && html`<p class="quiet">As long as nobody has driven.</p>`}
      <${DraftNote} draft=${draft} />
      ${error ? html`<${Failure} error=${error} />` : usual ? html`<${Form} usual=${usual} ...${props} />` : html`<p class="quiet">Reading the tracks …</p>`}
    </section>`;
}

function Form({ usual, wish = null, action, draft, send, leave }) {
  const form = useRef(null);
  const [refused, setRefused] = useState(null);
  const [slow, setSlow] = useState(false);
  const start = startOf(usual, wish);
  const values = { ...start, ...draft.edits };
  const { rules, wrong } = rulesOf(values);
  const named = values.name.trim() !== "";
  const checked = useChecked(
    "/api/races/check",
    named && !wrong.length ? rules : null,
    wish || draft.restored ? 0 : CHECK_MS,
  );
  const told = refused ?? (checked.error && aboutField(checked.error));
  const problems = told ? [...wrong, told] : wrong;
  useEffect(() => form.current.querySelector("input").focus(), []);

  const set = (key, value) => {
    setRefused(null);
    const edits = { ...draft.edits, [key]: value };
    if (JSON.stringify(value) === JSON.stringify(start[key])) delete edits[key];
    draft.set(edits);
  };
  const refuse = (about) => {
    setRefused(about);
    leadTo(about);
  };
  const [submit, busy] = useAction(async () => {
    const broken = form.current.querySelector("input:invalid")?.closest("[data-key]")?.dataset.key;
    if (wrong.length) return leadTo(wrong[0]);
    if (broken || !named)
      return refuse({
        ...{ severity: "error", key: broken ?? "name", remedy: "" },
        message: broken ? `“${LABELS[broken]}” is not a complete time.` : "Give the race a name.",
      });
    const timer = setTimeout(() => setSlow(true), SLOW_MS);
    try {
      await send(rules);
      draft.saved(values);
    } catch (error) {
      refuse(aboutField(error));
    } finally {
      clearTimeout(timer);
      setSlow(false);
    }
  });

  const tracks = usual.tracks.includes(start.world) ? usual.tracks : [start.world, ...usual.tracks];
  const control = (key) => {
    const common = {
      ...{ key, label: LABELS[key], help: HELP[key], value: values[key], "data-key": key },
      ...{ hidden: isHidden(key, values.race_type) },
      problems: problems.filter((each) => each.key === key),
    };
    if (key === "name" && wish) common.help = "The id of the race stays.";
    const change = (value) => set(key, value);
    const options = key === "world" ? tracks : CHOICES[key] && Object.entries(CHOICES[key]);
    if (options) return html`<${SelectField} ...${common} options=${options} onChange=${change} />`;
    const type = TIMES.includes(key) ? "datetime-local" : "text";
    const numeric = NUMBERS.includes(key);
    const unset = { obstacles: usual.obstacles, bots: usual.bots, seed: "random" }[key];
    return html`<${TextField} ...${common} type=${type} numeric=${numeric} onInput=${change} placeholder=${numeric ? String(unset ?? "default") : null} />`;
  };
  const sensor = (name) => html`
    <label key=${name} class="form-check"><input type="checkbox" checked=${values.sensors.includes(name)}
      onChange=${({ currentTarget: { checked: on } }) => set("sensors", on ? [...values.sensors, name] : values.sensors.filter((each) => each !== name))} /> ${name}</label>`;
  const parts = {
    Race: html`<label class="form-check"><input type="checkbox" checked=${values.reverse} onChange=${(event) => set("reverse", event.currentTarget.checked)} /> ${LABELS.reverse}</label>`,
    "Who and when": html`
      <div role="group" aria-label=${LABELS.sensors} data-key="sensors">
        <p class="race-label">${LABELS.sensors} (none chosen: any)</p>
        <div class="race-checks">${usual.sensors.map(sensor)}</div>
      </div>`,
  };
  return html`
    <form ref=${form} class="race-form" novalidate aria-label=${action} onSubmit=${(event) => {
      event.preventDefault();
      submit();
    }}>
      ${Object.entries(PARTS).map(
        ([name, keys]) => html`
          <fieldset key=${name}><legend>${name}</legend>
            <div class="fields">${keys.map(control)}</div>
            ${parts[name]}
          </fieldset>`,
      )}
      <div class="race-outcome" role="status"><${Outcome} ...${{ slow, named, problems, wish }} answer=${checked.answer} /></div>
      <p class="actions">
        <button type="submit" class="main" aria-disabled=${busy ? "true" : null}>${action}</button>
        <${Button} onClick=${() => {
          draft.set({});
          leave();
        }}>Cancel<//>
      </p>
    </form>`;
}

/** What the rules come to, or what stands in the way. */
function Outcome({ slow, named, problems, answer, wish }) {
  if (slow)
    return html`<p class="quiet">The bucket is being opened. This can take a minute if another command is starting or stopping its server; the form stays filled in.</p>`;
  if (problems.length) {
    const [first] = problems;
    if (!LABELS[first.key]) return html`<${Failure} error=${first} />`;
    return html`<p class="race-failed">Correct the field “${LABELS[first.key]}” first.</p>`;
  }
  if (!named) return html`<p class="quiet">Give the race a name.</p>`;
  if (!answer) return html`<p class="quiet">Your rules appear here as a sentence.</p>`;
  const { rules, words } = answer;
  return html`
    <p><strong>${rules.name}: </strong>${rules.world}${rules.reverse && ", opposite direction"}, ${words.kind}. ${words.decides} ${words.penalties}</p>
    <p class="quiet">Its id will be ${wish ? "the same as before" : answer.race || "drawn"}. ${words.conditions && html`Settings that the race keeps: <${Prose} text=${words.conditions} />.`}</p>`;
}
