// The form with all rules of a race, to make one or to change one. What it comes to is checked while it is filled.

import { api, get, post } from "/api.js";
import { failure, fill, h } from "/dom.js";
import { check, field, select } from "/form_dialog.js";
import { KINDS, PAIRINGS, RANKINGS } from "/race_words.js";

const CHECK_MS = 350;
const SLOW_MS = 2000;

// Options of `dr-race create` in messages of the server, and the fields that they mean.
const OPTIONS = {
  "--laps": "max_laps",
  "--min-laps": "min_laps",
  "--average-laps": "average_laps",
  "--off-track-penalty": "off_track_penalty_s",
  "--collision-penalty": "collision_penalty_s",
  "--max-submissions": "max_submissions",
  "--sensor": "sensors",
  "--opens": "opens",
  "--closes": "closes",
  "--seed": "seed",
  "--obstacles": "obstacles",
  "--bots": "bots",
  "--type": "race_type",
  DR_WORLD_NAME: "world",
  DR_OA_NUMBER_OF_OBSTACLES: "obstacles",
  DR_H2B_NUMBER_OF_BOT_CARS: "bots",
};
const LABELS = {
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
  sensors: "Sensors",
};

/** A sentence of the server about an option, with the label of the field instead; and the field. */
export function aboutField(error) {
  const found = Object.keys(OPTIONS)
    .filter((option) => new RegExp(`${option}(?![A-Za-z-])`).test(error.message))
    .sort((a, b) => b.length - a.length)[0];
  const name = found ? OPTIONS[found] : /name of the race/.test(error.message) ? "name" : null;
  const words = (text) =>
    Object.entries(OPTIONS)
      .sort(([a], [b]) => b.length - a.length)
      .reduce(
        (all, [option, key]) =>
          all.replace(new RegExp(`${option}(?![A-Za-z-])`, "g"), `“${LABELS[key]}”`),
        text ?? "",
      );
  return { name, message: words(error.message), remedy: words(error.remedy) };
}

const localTime = (unix) => {
  if (!unix) return "";
  const at = new Date(unix * 1000);
  return new Date(at - at.getTimezoneOffset() * 60_000).toISOString().slice(0, 16);
};

/**
 * The form.
 * @param {{usual: Object, wish?: Object, action: string, send: function(Object): Promise, cancel: function(), signal: AbortSignal}} spec
 *   `usual` is the answer of /api/races/form, `wish` the present rules of a race.
 */
export function raceForm({ usual, wish = null, action, send, cancel, signal }) {
  const now = wish ?? {};
  const digits = (
    name,
    { min = 0, max = null, step = 1, hint = "", value = now[name], placeholder = "" } = {},
  ) =>
    field(
      LABELS[name],
      h("input", {
        type: "number",
        name,
        min,
        max,
        step,
        value: value ?? "",
        placeholder,
        inputmode: step === 1 ? "numeric" : "decimal",
      }),
      hint,
    );
  const time = (name, value, hint) =>
    field(
      LABELS[name],
      h("input", { type: "datetime-local", name, value: localTime(value) }),
      hint,
    );
  const tracks = usual.tracks.includes(now.world ?? usual.world)
    ? usual.tracks
    : [now.world ?? usual.world, ...usual.tracks];
  const laps = digits("max_laps", {
    min: 1,
    max: 100,
    value: now.max_laps ?? 3,
    hint: "Each submission drives this many, one after the other.",
  });
  const ranking = field(
    LABELS.ranking,
    select("ranking", Object.entries(RANKINGS), now.ranking ?? "best-lap"),
  );
  const pairing = field(
    LABELS.pairing,
    select("pairing", Object.entries(PAIRINGS), now.pairing ?? "round-robin"),
  );
  const least = digits("min_laps", {
    min: 1,
    max: 100,
    placeholder: "default",
    hint: "A submission with fewer complete laps is not ranked. Empty: 1 for the best lap, all for the total time.",
  });
  const average = digits("average_laps", {
    min: 1,
    max: 100,
    placeholder: "default",
    hint: "Complete laps in a row. Empty: 3, or all if there are fewer.",
  });
  const obstacles = digits("obstacles", {
    max: 50,
    value: now.obstacles ?? "",
    placeholder: String(usual.obstacles),
    hint: "Boxes on the track. Empty: as in run.env.",
  });
  const bots = digits("bots", {
    max: 20,
    value: now.bots ?? "",
    placeholder: String(usual.bots),
    hint: "Cars that drive at a constant speed. Empty: as in run.env.",
  });
  const name = field(
    LABELS.name,
    h("input", {
      name: "name",
      required: true,
      maxlength: "64",
      autocomplete: "off",
      value: now.name ?? "",
    }),
    wish ? "The id of the race stays." : "What racers see, such as Friday Cup.",
  );
  const outcome = h(
    "div",
    { class: "race-outcome", role: "status" },
    h("p", { class: "quiet" }, "Your rules appear here as a sentence."),
  );
  const button = h("button", { class: "main" }, action);
  const form = h(
    "form",
    { class: "race-form", novalidate: true, "aria-label": action },
    h(
      "fieldset",
      {},
      h("legend", {}, "Race"),
      h(
        "div",
        { class: "race-fields" },
        name,
        field(LABELS.world, select("world", tracks, now.world ?? usual.world)),
        field(
          LABELS.race_type,
          select("race_type", Object.entries(KINDS), now.race_type ?? "TIME_TRIAL"),
        ),
        obstacles,
        bots,
      ),
      check(LABELS.reverse, "reverse", now.reverse ?? false),
    ),
    h(
      "fieldset",
      {},
      h("legend", {}, "What decides"),
      h(
        "div",
        { class: "race-fields" },
        ranking,
        pairing,
        laps,
        least,
        average,
        digits("off_track_penalty_s", {
          max: 600,
          step: "any",
          value: now.off_track_penalty_s ?? usual.off_track_penalty_s,
        }),
        digits("collision_penalty_s", {
          max: 600,
          step: "any",
          value: now.collision_penalty_s ?? usual.collision_penalty_s,
        }),
      ),
    ),
    h(
      "fieldset",
      {},
      h("legend", {}, "Who and when"),
      h(
        "div",
        { class: "race-fields" },
        digits("max_submissions", {
          max: 1000,
          placeholder: "default",
          hint: "0 for any number. Empty: 1 in pairs, else any number.",
        }),
        time("opens", now.opens_at, "Empty: at once."),
        time("closes", now.closes_at, "Empty: stays open until somebody closes it."),
        digits("seed", {
          max: 4294967295,
          placeholder: "random",
          hint: "All submissions drive with this seed. Empty: a random one.",
        }),
      ),
      h(
        "div",
        { role: "group", "aria-label": "Allowed sensors" },
        h("p", { class: "race-label" }, "Allowed sensors (none chosen: any)"),
        h(
          "div",
          { class: "race-checks" },
          usual.sensors.map((sensor) =>
            h(
              "label",
              { class: "check" },
              h("input", {
                type: "checkbox",
                name: "sensors",
                value: sensor,
                checked: now.sensors?.includes(sensor),
              }),
              ` ${sensor}`,
            ),
          ),
        ),
      ),
    ),
    outcome,
    h("p", { class: "actions" }, button, h("button", { type: "button", click: cancel }, "Cancel")),
  );

  const values = () => {
    const given = new FormData(form),
      out = { reverse: given.has("reverse"), sensors: given.getAll("sensors") };
    for (const key of ["name", "world", "race_type", "ranking", "pairing"])
      out[key] = given.get(key) ?? "";
    const hidden = new Set([...form.querySelectorAll("[hidden] [name]")].map((each) => each.name));
    for (const key of [
      "max_laps",
      "min_laps",
      "average_laps",
      "off_track_penalty_s",
      "collision_penalty_s",
      "max_submissions",
      "obstacles",
      "bots",
      "seed",
    ]) {
      const text = given.get(key);
      out[key] = hidden.has(key) || text === "" || text === null ? null : Number(text);
    }
    for (const key of ["opens", "closes"])
      out[key] = given.get(key) ? new Date(given.get(key)).toISOString() : "";
    return out;
  };

  function arrange() {
    const kind = form.elements.race_type.value,
      inPairs = kind === "HEAD_TO_MODEL";
    obstacles.hidden = kind !== "OBJECT_AVOIDANCE";
    bots.hidden = kind !== "HEAD_TO_BOT";
    pairing.hidden = !inPairs;
    ranking.hidden = least.hidden = average.hidden = inPairs;
  }

  function problem(error) {
    const about = aboutField(error);
    for (const each of form.elements) each.removeAttribute?.("aria-invalid");
    if (about.name)
      form.querySelector(`[name="${about.name}"]`)?.setAttribute("aria-invalid", "true");
    fill(outcome, failure(about));
    return about.name;
  }

  function unreadable() {
    const wrong = [...form.elements].find((each) => each.validity?.badInput);
    return wrong
      ? {
          message: `“${LABELS[wrong.name]}” is not a number.`,
          remedy: "Write digits, such as 3 or 2.5.",
        }
      : null;
  }

  let timer = 0,
    turn = 0;
  async function checkNow() {
    const mine = (turn += 1),
      wrong = unreadable();
    if (wrong) {
      fill(outcome, failure(wrong));
      return;
    }
    if (!values().name.trim()) {
      fill(outcome, h("p", { class: "quiet" }, "Give the race a name."));
      return;
    }
    try {
      const found = await post(api("races", "check"), values(), signal);
      if (mine !== turn) return;
      for (const each of form.elements) each.removeAttribute?.("aria-invalid");
      const { rules, words } = found;
      fill(
        outcome,
        h(
          "p",
          {},
          h("strong", {}, `${rules.name}: `),
          `${rules.world}${rules.reverse ? ", opposite direction" : ""}, ${words.kind}. ${words.decides} ${words.penalties}`,
        ),
        h(
          "p",
          { class: "quiet" },
          `Its id will be ${wish ? "the same as before" : found.race || "drawn"}. `,
          words.conditions ? `Settings of run.env that the race keeps: ${words.conditions}.` : "",
        ),
      );
    } catch (error) {
      if (error.name === "AbortError" || mine !== turn) return;
      problem(error);
    }
  }
  const soon = () => {
    arrange();
    clearTimeout(timer);
    timer = setTimeout(checkNow, CHECK_MS);
  };
  form.addEventListener("input", soon);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    clearTimeout(timer);
    turn += 1;
    const wrong = unreadable();
    if (wrong) {
      fill(outcome, failure(wrong));
      form.querySelector(":invalid")?.focus();
      return;
    }
    button.disabled = true;
    const slow = setTimeout(
      () =>
        fill(
          outcome,
          h(
            "p",
            { class: "quiet" },
            "The bucket is being opened. This can take a minute if another command is starting or stopping its server; the form stays filled in.",
          ),
        ),
      SLOW_MS,
    );
    try {
      await send(values());
    } catch (error) {
      if (error.name === "AbortError") return;
      const named = problem(error);
      if (named) form.querySelector(`[name="${named}"]`)?.focus();
    } finally {
      clearTimeout(slow);
      button.disabled = false;
    }
  });
  signal.addEventListener("abort", () => clearTimeout(timer), { once: true });
  arrange();
  if (wish) soon();
  return form;
}

/** The values that the form begins with. */
export const usualRules = (signal) => get(api("races", "form"), signal);
