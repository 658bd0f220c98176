// All races of the bucket, and the form that makes one.

import { api, post } from "/api.js";
import { empty, failure, fill, h, number } from "/dom.js";
import { raceForm, usualRules } from "/race_form.js";
import { KINDS, dateText, nightLink, raceLink, stateBadge, waitText } from "/race_words.js";
import { follow } from "/socket.js";

export const title = "Races";

const COLUMNS = ["Race", "State", "Track", "Kind", "Leader", "Submissions", "Queue", "Made"];

export function show(main, params, { signal, query }) {
  const list = h("div", { class: "race-list" }, h("p", { class: "quiet" }, "Reading the bucket …"));
  const place = h("div", {});
  const make = h(
    "button",
    {
      type: "button",
      class: "main",
      "aria-expanded": "false",
      click: () => (place.firstChild ? close() : open()),
    },
    "Make a race",
  );
  fill(
    main,
    h("h1", {}, "Races"),
    h(
      "p",
      {},
      "A leaderboard over models of this bucket: racers submit checkpoints, a queue drives them under the same rules, and the best is first.",
    ),
    h("p", { class: "actions" }, make),
    place,
    list,
  );

  function close() {
    fill(place);
    make.setAttribute("aria-expanded", "false");
    make.focus();
  }

  async function open() {
    make.setAttribute("aria-expanded", "true");
    fill(place, h("p", { class: "quiet" }, "Reading the tracks …"));
    try {
      const usual = await usualRules(signal);
      const send = async (wish) => {
        location.hash = raceLink((await post(api("races"), wish, signal)).race);
      };
      fill(
        place,
        h(
          "section",
          { class: "race-card", "aria-label": "Make a race" },
          h("h2", {}, "Make a race"),
          raceForm({ usual, action: "Make this race", send, cancel: close, signal }),
        ),
      );
      place.querySelector("input").focus();
    } catch (error) {
      if (error.name !== "AbortError") fill(place, failure(error));
    }
  }

  follow(
    "races",
    (found) => {
      if (found.error) {
        fill(list, failure(found.error));
        return;
      }
      const focused = document.activeElement?.dataset?.race;
      fill(
        list,
        found.races.length
          ? table(found.races)
          : place.firstChild
            ? null
            : empty(
                `There is no race in s3://${found.bucket} yet. Make one, let racers submit their models, and drive its queue.`,
                h("button", { type: "button", click: open }, "Make the first race"),
              ),
        found.damaged.map((message) => failure({ message, remedy: "" })),
      );
      if (focused)
        list.querySelector(`[data-race="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
    },
    signal,
  );

  if (query?.has("new")) open();
}

function table(races) {
  const cell = (k, kind, ...content) =>
    h("td", { class: kind, role: "cell", "data-label": COLUMNS[k] }, h("span", {}, content));
  return h(
    "div",
    { class: "scroll", tabindex: "0", role: "region", "aria-label": "Races" },
    h(
      "table",
      { class: "race-table", role: "table" },
      h(
        "caption",
        {},
        number(races.length),
        races.length === 1 ? " race, " : " races, ",
        "the newest first",
      ),
      h(
        "thead",
        { role: "rowgroup" },
        h(
          "tr",
          { role: "row" },
          COLUMNS.map((name) => h("th", { scope: "col", role: "columnheader" }, name)),
        ),
      ),
      h(
        "tbody",
        { role: "rowgroup" },
        races.map((race) =>
          h(
            "tr",
            { role: "row" },
            h(
              "th",
              { scope: "row", role: "rowheader" },
              h("a", { href: raceLink(race.race), "data-race": race.race }, race.name),
            ),
            cell(1, null, stateBadge(race.state)),
            cell(2, null, race.world),
            cell(3, null, KINDS[race.race_type]),
            cell(
              4,
              null,
              race.leader ?? "nobody yet",
              race.leader_s === null ? null : ` ${race.leader_text}`,
            ),
            cell(5, "number", number(race.submissions)),
            cell(
              6,
              null,
              race.queued ? waitText(race.queued) : "empty",
              race.runner ? ", being driven" : "",
              " ",
              h(
                "a",
                { href: nightLink(race.race), "aria-label": `Race night of ${race.name}` },
                "Race night",
              ),
            ),
            cell(7, null, dateText(race.created_at)),
          ),
        ),
      ),
    ),
  );
}
