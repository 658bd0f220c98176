// What organisers and racers do with a race: submit, drive, open, close, change, save, delete, watch.

import { api, get, post, remove } from "/api.js";
import { bytes, confirmed, failure, fill, h, notify, number } from "/dom.js";
import { ask, check, field, select } from "/form_dialog.js";
import { raceForm, usualRules } from "/race_form.js";
import { keepFile, racePath, videoPath, waitText } from "/race_words.js";

/**
 * The actions of a race.
 * @param {{id: string, now: function(): Object, act: function, take: function(Object), place: Element, left: function(), signal: AbortSignal}} page
 *   `now` gives the race as it was last told, `take` shows a newer one, `act` asks the server for something;
 *   `place` is for the form of the rules, and `left` is called when that is left.
 */
export function raceActions({ id, now, act, take, place, left, signal }) {
  async function submit() {
    let found, usual;
    try {
      [found, usual] = await Promise.all([get(api("races", "models"), signal), usualRules(signal)]);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
      return;
    }
    if (!found.models.length) {
      notify(
        "There is no model in this bucket yet.",
        "bad",
        "Train one, or import one on the page Models.",
      );
      return;
    }
    const model = select(
      "prefix",
      found.models.map((each) => each.prefix),
      usual.model,
    );
    const numbers = h("datalist", { id: "race-checkpoints" });
    const best = h("p", { class: "quiet fine" });
    const list = async () => {
      fill(
        numbers,
        ["best", "last"].map((word) => h("option", { value: word })),
      );
      try {
        best.textContent = "";
        const { checkpoints, about } = await get(
          `${api("races", "checkpoints")}?prefix=${encodeURIComponent(model.value)}`,
          signal,
        );
        best.textContent = about;
        numbers.append(...checkpoints.map((each) => h("option", { value: String(each) })));
      } catch {
        /* the words are enough */
      }
    };
    model.addEventListener("change", list);
    list();
    let given = { racer: usual.racer, prefix: model.value, checkpoint: "best" },
      wrong = null;
    for (;;) {
      model.value = given.prefix;
      const values = await ask({
        title: "Submit a model",
        intro: wrong
          ? failure(wrong)
          : h("p", {}, "The race gets a copy: you can train on, or delete the model."),
        action: "Submit",
        fields: [
          field(
            "Racer",
            h("input", {
              name: "racer",
              required: true,
              maxlength: "64",
              value: given.racer,
              autocomplete: "nickname",
            }),
            "Each racer has one place on the leaderboard.",
          ),
          field("Model", model),
          field(
            "Checkpoint",
            h("input", {
              name: "checkpoint",
              required: true,
              value: given.checkpoint,
              list: "race-checkpoints",
              autocomplete: "off",
            }),
            "best, last, or the number of one.",
          ),
          best,
          numbers,
        ],
      });
      if (!values || signal.aborted) return;
      given = values;
      try {
        const { taken, race: now } = await post(
          racePath(id, "submit"),
          { racer: values.racer, prefix: values.prefix, checkpoint: values.checkpoint },
          signal,
        );
        take(now);
        notify(
          `${taken.racer} has submitted checkpoint ${taken.checkpoint} of ${taken.model}.${taken.queue ? "" : " Drive the queue to see its laps."}`,
        );
        return;
      } catch (error) {
        if (error.name === "AbortError") return;
        wrong = error;
      }
    }
  }

  async function run() {
    const values = await ask({
      title: "Drive the queue",
      action: "Drive it",
      intro: h(
        "p",
        {},
        `${waitText(now().queue.length)} in the queue. This machine drives one after the other in the background, also when this page is closed.`,
      ),
      fields: [
        field(
          "Videos",
          select(
            "video",
            [
              ["", "If the video encoder is installed"],
              ["yes", "Yes; refuse without the encoder"],
              ["no", "No, which is faster"],
            ],
            "",
          ),
        ),
      ],
    });
    if (values) await act("run", { video: { yes: true, no: false }[values.video] ?? null });
  }

  async function close() {
    if (
      await confirmed("Close this race for submissions?", {
        action: "Close it",
        detail:
          "What waits in the queue is still driven, and then there is a winner. You can open it again.",
      })
    )
      act("close");
  }

  async function reopen() {
    const values = await ask({
      title: "Take submissions from now on",
      action: "Open it",
      fields: [
        field(
          "Closes",
          h("input", { type: "datetime-local", name: "closes" }),
          "Empty: when somebody closes it.",
        ),
      ],
    });
    if (values) act("open", { closes: values.closes ? new Date(values.closes).toISOString() : "" });
  }

  async function savePage() {
    const films = now().leaderboard.filter((row) => row.video).length;
    const values = await ask({
      title: "Save this race as one HTML file",
      action: "Save",
      intro: h("p", {}, "It needs no network and has no scripts."),
      fields: [
        films
          ? check(
              `With ${number(films)} ${films === 1 ? "video" : "videos"} of the leaderboard (a few MB each)`,
              "videos",
            )
          : h("p", { class: "quiet" }, "There are no videos on the leaderboard."),
      ],
    });
    if (values) keep(`page.html${values.videos ? "?videos=1" : ""}`, `${id}.html`);
  }

  async function keep(path, name) {
    try {
      await keepFile(`${racePath(id)}/${path}`, name);
    } catch (error) {
      notify(error.message, "bad", error.remedy);
    }
  }

  async function log() {
    let found;
    try {
      found = await get(racePath(id, "log"), signal);
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
      return;
    }
    const dialog = h(
      "dialog",
      { class: "race-wide", "aria-label": "Log of the queue" },
      h("h2", {}, "Log of the queue"),
      found.text === null
        ? h("p", {}, "This machine has not driven the queue of this race in the background yet.")
        : [
            h("p", { class: "quiet" }, `The end of ${found.path}`),
            h("pre", { class: "race-log", tabindex: "0" }, found.text),
          ],
      h("form", { method: "dialog", class: "actions" }, h("button", { autofocus: true }, "Close")),
    );
    present(dialog);
  }

  async function edit() {
    try {
      const [usual, rules] = await Promise.all([
        usualRules(signal),
        get(racePath(id, "rules"), signal),
      ]);
      const leave = () => {
        fill(place);
        left();
      };
      const send = async (wish) => {
        take((await post(racePath(id, "rules"), wish, signal)).race);
        leave();
        notify("The rules were changed.");
      };
      fill(
        place,
        h(
          "section",
          { class: "race-card", "aria-label": "Change the rules" },
          h("h2", {}, "Change the rules"),
          h("p", { class: "quiet" }, "As long as nobody has driven."),
          raceForm({
            usual,
            wish: { ...rules.wish, obstacles: rules.obstacles, bots: rules.bots },
            action: "Change the rules",
            send,
            cancel: leave,
            signal,
          }),
        ),
      );
      place.querySelector("input").focus();
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
    }
  }

  async function erase() {
    try {
      const planned = await remove(`${racePath(id)}?dry_run`, signal);
      const detail = `${number(planned.objects)} objects (${bytes(planned.size_bytes)}): its submissions, laps and videos. The models of the racers stay. It cannot be undone.`;
      if (
        !(await confirmed(`Delete the race ${now().rules.name}?`, {
          action: "Delete this race",
          detail,
        }))
      )
        return;
      await remove(racePath(id), signal);
      notify(`The race ${now().rules.name} was deleted.`);
      location.hash = "#/races";
    } catch (error) {
      if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
    }
  }

  function present(dialog) {
    const end = () => dialog.close();
    signal.addEventListener("abort", end, { once: true });
    dialog.addEventListener("close", () => {
      signal.removeEventListener("abort", end);
      dialog.remove();
    });
    document.body.append(dialog);
    dialog.showModal();
  }

  function watch(key, name) {
    const note = h(
      "p",
      { class: "problem", hidden: true },
      "This video cannot be played here. Save it, and open it with another player.",
    );
    const video = h("video", {
      controls: true,
      autoplay: true,
      muted: true,
      playsinline: true,
      src: videoPath(id, key),
      "aria-label": `Video: ${name}`,
      error: () => {
        note.hidden = false;
      },
    });
    present(
      h(
        "dialog",
        { class: "race-wide", "aria-label": `Video: ${name}` },
        h("h2", {}, name),
        video,
        note,
        h(
          "form",
          { method: "dialog", class: "actions" },
          h("button", { autofocus: true }, "Close"),
          h(
            "a",
            { class: "button", href: videoPath(id, key, true), download: "" },
            "Save the video",
          ),
        ),
      ),
    );
  }

  return { submit, run, close, reopen, savePage, keep, log, edit, erase, watch };
}
