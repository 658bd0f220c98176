// One race: leaderboard, submissions, queue, pairs, and everything that its organiser and its racers do.

import { post } from "/api.js";
import { confirmed, empty, failure, fill, h, moment, notify, number } from "/dom.js";
import { raceActions } from "/race_actions.js";
import { pairsView } from "/race_pairs.js";
import {
  dateText,
  gapText,
  lapsText,
  nightLink,
  racePath,
  rankText,
  stateBadge,
  waitText,
} from "/race_words.js";
import { follow } from "/socket.js";

export const title = "Race";

export function show(main, [id], { signal }) {
  const head = h(
    "div",
    { class: "race-head" },
    h("h1", {}, "Race"),
    h("p", { class: "quiet" }, "Reading the bucket …"),
  );
  const actions = h("p", { class: "actions race-actions" }),
    trouble = h("div", { role: "status" });
  const editor = h("div", {}),
    board = h("section", { class: "race-page-part", "aria-label": "Leaderboard" }),
    queue = h("section", { "aria-label": "Queue" });
  const pairs = h("section", { "aria-label": "Pairs" }),
    submissions = h("section", { class: "race-page-part", "aria-label": "Submissions" });
  fill(
    main,
    h("p", {}, h("a", { href: "#/races" }, "All races")),
    head,
    actions,
    trouble,
    editor,
    board,
    h("div", { class: "race-columns" }, queue, pairs),
    submissions,
  );
  let race = null,
    drawn = "",
    before = Promise.resolve();
  const does = raceActions({
    id,
    now: () => race,
    act,
    take,
    place: editor,
    left: () => actions.querySelector('[data-key="rules"]')?.focus(),
    signal,
  });

  follow(`race:${id}`, take, signal);

  function take(value) {
    if (value.error) {
      drawn = "";
      if (race) fill(trouble, failure(value.error));
      else fill(head, h("h1", {}, "Race"), failure(value.error));
      return;
    }
    const text = JSON.stringify(value);
    if (text === drawn) return;
    drawn = text;
    race = value;
    const focused = document.activeElement?.dataset?.key;
    fill(
      trouble,
      race.damaged.map((message) => failure({ message })),
    );
    document.title = `${race.rules.name} – DeepRacer console`;
    drawHead();
    drawActions();
    drawBoard();
    drawQueue();
    pairs.className = race.rules.pairing === "bracket" ? "wide" : "";
    fill(
      pairs,
      race.rules.race_type === "HEAD_TO_MODEL"
        ? [h("h2", {}, "Pairs"), pairsView(race, does.watch)]
        : null,
    );
    drawSubmissions();
    if (focused && document.activeElement === document.body)
      main
        .querySelector(`[data-key="${CSS.escape(focused)}"]:not(:disabled)`)
        ?.focus({ preventScroll: true });
  }

  /** Do something with the race, show what it has become, and say what went wrong; one after the other. */
  function act(name, body = {}, said = "") {
    before = before.then(async () => {
      try {
        const answer = await post(racePath(id, name), body, signal);
        if (answer.race) take(answer.race);
        if (said) notify(said);
        return answer;
      } catch (error) {
        if (error.name !== "AbortError") notify(error.message, "bad", error.remedy);
        return null;
      }
    });
    return before;
  }

  function drawHead() {
    const { rules, words } = race,
      times = [];
    if (rules.opens_at) times.push(`Opens ${moment(rules.opens_at)}.`);
    if (rules.closes_at)
      times.push(
        `${race.state === "open" || race.state === "scheduled" ? "Closes" : "Closed"} ${moment(rules.closes_at)}.`,
      );
    if (rules.max_submissions)
      times.push(
        `Each racer has ${number(rules.max_submissions)} ${rules.max_submissions === 1 ? "submission" : "submissions"}.`,
      );
    if (rules.sensors.length) times.push(`Sensors: ${rules.sensors.join(", ")}.`);
    fill(
      head,
      h("h1", {}, rules.name, " ", stateBadge(race.state)),
      h("p", {}, words.place, ". ", words.decides, " ", words.penalties),
      h(
        "p",
        { class: "race-standing", role: "status" },
        race.winner ? `Winner: ${race.winner}.` : standing(),
      ),
      h(
        "p",
        { class: "quiet" },
        times.join(" "),
        words.conditions ? ` Settings: ${words.conditions}.` : "",
        race.runner ? ` The queue is driven by ${race.runner}.` : "",
      ),
    );
  }

  function standing() {
    const first = {
      scheduled: "Not open yet.",
      open: "Open for submissions.",
      closed: "Closed for submissions.",
      finished: "Finished; nobody is ranked.",
    }[race.state];
    const drives = race.moments.driving
      ? ` ${race.moments.driving.cars.map((car) => car.racer).join(" against ")} ${race.moments.driving.cars.length > 1 ? "drive" : "drives"} now.`
      : "";
    const waits = race.queue.length
      ? ` ${waitText(race.queue.length)} in the queue${race.runner ? "." : ", but nobody is driving it."}`
      : "";
    return first + drives + waits;
  }

  function drawActions() {
    const button = (key, text, click, kind = "") =>
      h("button", { type: "button", "data-key": key, class: kind || null, click }, text);
    const open = race.state === "open";
    fill(
      actions,
      open ? button("submit", "Submit a model", does.submit, "main") : null,
      race.runner
        ? race.here
          ? button("stop", "Stop the queue", () =>
              act("stop", {}, "The queue was stopped. What was driven is kept."),
            )
          : null
        : race.queue.length
          ? button("run", "Drive the queue", does.run, open ? "" : "main")
          : null,
      h("a", { class: "button", href: nightLink(id), "data-key": "night" }, "Race night"),
      race.state === "open" || race.state === "scheduled"
        ? button("close", "Close for submissions", does.close)
        : null,
      race.state !== "open"
        ? button("open", race.state === "scheduled" ? "Open now" : "Open again", does.reopen)
        : null,
      button("csv", "Save as CSV", () => does.keep("table.csv", `${id}.csv`)),
      button("html", "Save as a page", does.savePage),
      button("log", "Log of the queue", does.log),
      race.changeable ? button("rules", "Change the rules", does.edit) : null,
      button("delete", "Delete", does.erase, "danger"),
    );
  }

  function watchButton(row) {
    return row.video
      ? h(
          "button",
          {
            type: "button",
            class: "race-small",
            "data-key": `watch-${row.submission}`,
            "aria-label": `Watch the video of ${row.racer}`,
            click: () => does.watch(row.video, row.racer),
          },
          "Watch",
        )
      : "–";
  }

  function drawBoard() {
    const inPairs = race.rules.race_type === "HEAD_TO_MODEL";
    if (!race.leaderboard.length) {
      const next = race.submissions.length
        ? "Nobody has driven yet. Drive the queue."
        : race.state === "open"
          ? "Nobody has submitted a model yet."
          : "Nobody has driven.";
      fill(board, h("h2", {}, "Leaderboard"), empty(next));
      return;
    }
    const columns = inPairs
      ? [
          ["Points", (row) => number(row.points ?? 0, row.points % 1 ? 1 : 0)],
          ["Won, drawn, lost", (row) => `${row.wins}, ${row.draws}, ${row.losses}`],
          ["Best lap", (row) => row.best_lap_text],
        ]
      : [
          ["Best lap", (row) => row.best_lap_text, "best-lap"],
          [
            `Best average of ${race.rules.average_laps} laps`,
            (row) => row.best_average_text,
            "best-average",
          ],
          ["Total time", (row) => row.total_text, "total-time"],
          ["Gap", gapText],
        ];
    columns.push(
      ["Laps", (row) => row.laps_text],
      ["Off track", (row) => number(row.off_track)],
      ["Crashes", (row) => number(row.crashes)],
    );
    const names = ["Rank", "Racer", "Model", ...columns.map(([name]) => name), "Video"];
    const cell = (name, kind, ...content) =>
      h("td", { class: kind, role: "cell", "data-label": name }, h("span", {}, content));
    fill(
      board,
      h("h2", {}, "Leaderboard"),
      race.limit ? h("p", { class: "quiet" }, `The best lap, ${race.limit}.`) : null,
      h(
        "div",
        { class: "scroll", tabindex: "0", role: "region", "aria-label": "Leaderboard" },
        h(
          "table",
          { class: "race-table", role: "table" },
          h(
            "caption",
            {},
            "Times in minutes:seconds; penalties are included. ",
            inPairs ? "" : "The column in bold decides.",
          ),
          h(
            "thead",
            { role: "rowgroup" },
            h(
              "tr",
              { role: "row" },
              names.map((name) =>
                h(
                  "th",
                  {
                    scope: "col",
                    role: "columnheader",
                    class: columns.some(([each]) => each === name) ? "figure" : null,
                  },
                  name,
                ),
              ),
            ),
          ),
          h(
            "tbody",
            { role: "rowgroup" },
            race.leaderboard.map((row) =>
              h(
                "tr",
                { role: "row", class: row.rank === 1 ? "first" : null },
                cell("Rank", "rank", rankText(row)),
                cell("Racer", "racer", row.racer),
                cell(
                  "Model",
                  null,
                  row.model,
                  h(
                    "span",
                    { class: "quiet race-checkpoint" },
                    ` checkpoint ${row.checkpoint.split("_")[0]}`,
                  ),
                ),
                columns.map(([name, text, ranking]) =>
                  cell(
                    name,
                    `figure${ranking === race.rules.ranking ? " decides" : ""}`,
                    text(row),
                  ),
                ),
                cell("Video", null, watchButton(row)),
              ),
            ),
          ),
        ),
      ),
    );
  }

  function drawQueue() {
    const entries = new Map(race.submissions.map((entry) => [entry.submission, entry]));
    const inPairs = race.rules.race_type === "HEAD_TO_MODEL";
    const movable = race.drawn ? [] : [...new Set(race.queue.flatMap((run) => run.split("+")))];
    const move = async (name, place) => {
      const there = await act("move", { submission: name, place });
      if (there) queue.querySelector(`[data-key="item-${name}"]`)?.focus();
    };
    const item = (name, k) => {
      const entry = entries.get(name);
      const who = `${entry.racer}, ${entry.model}`;
      return h(
        "li",
        {
          tabindex: "0",
          "data-key": `item-${name}`,
          "aria-label": `${k + 1}. ${who}`,
          "aria-keyshortcuts": "Alt+ArrowUp Alt+ArrowDown",
          keydown: (event) => {
            if (!event.altKey || !["ArrowUp", "ArrowDown"].includes(event.key)) return;
            event.preventDefault();
            const place = k + (event.key === "ArrowUp" ? 0 : 2);
            if (place >= 1 && place <= movable.length) move(name, place);
          },
        },
        h(
          "span",
          { class: "race-who" },
          h("strong", {}, entry.racer),
          h("span", { class: "quiet" }, ` ${entry.model}`),
        ),
        h(
          "span",
          { class: "race-buttons" },
          h(
            "button",
            {
              type: "button",
              class: "race-small",
              "data-key": `up-${name}`,
              disabled: k === 0,
              "aria-label": `Move ${who} up`,
              click: () => move(name, k),
            },
            "↑",
          ),
          h(
            "button",
            {
              type: "button",
              class: "race-small",
              "data-key": `down-${name}`,
              disabled: k === movable.length - 1,
              "aria-label": `Move ${who} down`,
              click: () => move(name, k + 2),
            },
            "↓",
          ),
          h(
            "button",
            {
              type: "button",
              class: "race-small",
              "data-key": `withdraw-${name}`,
              "aria-label": `Withdraw ${who}`,
              click: () => withdraw(entry),
            },
            "Withdraw",
          ),
        ),
      );
    };
    const driving = race.moments.driving;
    fill(
      queue,
      h("h2", {}, "Queue"),
      driving
        ? h(
            "p",
            { class: "race-driving" },
            h("span", { class: "dot good" }),
            `${driving.cars.map((car) => car.racer).join(" against ")}, driven since ${moment(driving.began_at)}`,
          )
        : null,
      movable.length
        ? [
            h(
              "p",
              { class: "quiet" },
              inPairs ? "Pairs are made in this order. " : "They drive in this order. ",
              "The arrows move a submission; so do Alt and the arrow keys.",
            ),
            h("ol", { class: "race-queue" }, movable.map(item)),
          ]
        : h(
            "p",
            { class: "quiet" },
            race.drawn
              ? `The bracket is drawn; ${waitText(race.queue.length)}.`
              : "The queue is empty.",
          ),
    );
  }

  async function withdraw(entry) {
    if (
      await confirmed(`Withdraw ${entry.racer}'s ${entry.model}?`, {
        action: "Withdraw it",
        detail:
          "Its laps are removed, and it no longer counts. It cannot be undone; the model stays.",
      })
    )
      act("withdraw", { submission: entry.submission });
  }

  async function restart(entry) {
    if (
      await confirmed(`Drive ${entry.racer}'s ${entry.model} again?`, {
        action: "Drive it again",
        detail: "Its present laps no longer count.",
      })
    )
      act("restart", { submission: entry.submission });
  }

  function drawSubmissions() {
    if (!race.submissions.length) {
      fill(submissions);
      return;
    }
    const STATES = {
      queued: "waits",
      running: "is driven now",
      done: "was driven",
      failed: "failed",
      "over the limit": "does not count: the racer has more submissions than the rules allow",
    };
    fill(
      submissions,
      h("h2", {}, "Submissions"),
      h(
        "ul",
        { class: "race-submissions" },
        race.submissions.map((entry) =>
          h(
            "li",
            {},
            h(
              "div",
              {},
              h("strong", {}, entry.racer),
              ` ${entry.model}, checkpoint ${entry.checkpoint.split("_")[0]} `,
              h("span", { class: "quiet" }, `${entry.submission}, ${dateText(entry.submitted_at)}`),
              h(
                "p",
                { class: entry.state === "failed" ? "race-failed" : null },
                entry.lap_s.length ? lapsText(entry) : (STATES[entry.state] ?? entry.state),
                entry.message ? `: ${entry.message} ${entry.remedy}` : "",
              ),
              entry.notes.map((note) => h("p", { class: "quiet" }, note)),
            ),
            h(
              "span",
              { class: "race-buttons" },
              entry.video
                ? h(
                    "button",
                    {
                      type: "button",
                      class: "race-small",
                      "data-key": `film-${entry.submission}`,
                      "aria-label": `Watch the video of ${entry.racer}, ${entry.model}`,
                      click: () => does.watch(entry.video, `${entry.racer}, ${entry.model}`),
                    },
                    "Watch",
                  )
                : null,
              entry.state === "done" || entry.state === "failed"
                ? h(
                    "button",
                    {
                      type: "button",
                      class: "race-small",
                      "data-key": `restart-${entry.submission}`,
                      "aria-label": `Drive ${entry.racer}, ${entry.model} again`,
                      click: () => restart(entry),
                    },
                    "Drive again",
                  )
                : null,
              entry.state === "queued"
                ? null
                : h(
                    "button",
                    {
                      type: "button",
                      class: "race-small",
                      "data-key": `remove-${entry.submission}`,
                      "aria-label": `Withdraw ${entry.racer}, ${entry.model}`,
                      click: () => withdraw(entry),
                    },
                    "Withdraw",
                  ),
            ),
          ),
        ),
      ),
    );
  }
}
