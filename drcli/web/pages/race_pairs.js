// The pairs of a race: a table of everybody against everybody, or a bracket whose winners go on.

import { h } from "/dom.js";

const STATES = {
  waiting: "waits for earlier pairs",
  queued: "in the queue",
  running: "driven now",
  failed: "failed",
  alone: "goes on without racing",
};

/** The pairs of a race in pairs. */
export function pairsView(race, watch) {
  if (!race.pairs.length)
    return h("p", { class: "quiet" }, "Two submissions make a pair. There are not enough yet.");
  return race.rules.pairing === "bracket" ? bracket(race, watch) : rounds(race, watch);
}

function car(pair, side, alone) {
  const id = pair[side],
    racer = pair[`${side}_racer`];
  const won = !alone && pair.winner && pair.winner === id;
  const result = pair.state === "done" ? pair[`${side}_text`] : "";
  return h(
    "div",
    { class: `race-side${won ? " won" : ""}` },
    h(
      "span",
      {},
      id ? racer : alone ? "nobody" : "not known yet",
      won ? h("span", { class: "race-won" }, " wins") : null,
    ),
    h("span", { class: "quiet" }, result),
  );
}

function card(pair, watch) {
  const alone = pair.state === "alone";
  return h(
    "div",
    { class: `race-pair ${pair.state}` },
    car(pair, "first", alone),
    car(pair, "second", alone),
    h(
      "p",
      { class: "race-pair-state" },
      pair.state === "done"
        ? pair.winner
          ? ""
          : "Nobody wins."
        : `${STATES[pair.state] ?? pair.state}${pair.state === "failed" ? `: ${pair.message} ${pair.remedy}` : ""}`,
      pair.videos.map((key, k) =>
        h(
          "button",
          {
            type: "button",
            class: "race-small",
            "data-key": `watch-${key}`,
            click: () =>
              watch(
                key,
                `${pair.first_racer} against ${pair.second_racer}, car of ${k ? pair.second_racer : pair.first_racer}`,
              ),
          },
          k ? "Video 2" : "Video",
        ),
      ),
    ),
  );
}

function byRound(pairs) {
  const found = [];
  for (const pair of pairs) (found[pair.round - 1] ??= []).push(pair);
  return found;
}

function bracket(race, watch) {
  const all = byRound(race.pairs);
  const name = (round) =>
    ["Final", "Semi-finals", "Quarter-finals"][all.length - 1 - round] ?? `Round ${round + 1}`;
  return h(
    "div",
    {},
    race.drawn
      ? null
      : h(
          "p",
          { class: "quiet" },
          "The bracket is drawn when its first pair is driven, in the order of the queue; until then it changes with every submission.",
        ),
    h(
      "div",
      { class: "scroll", tabindex: "0", role: "region", "aria-label": "Bracket" },
      h(
        "div",
        { class: "race-bracket" },
        all.map((pairs, round) =>
          h(
            "section",
            { class: "race-round" },
            h("h3", {}, name(round)),
            h(
              "ol",
              {},
              pairs.map((pair) => h("li", {}, card(pair, watch))),
            ),
          ),
        ),
      ),
    ),
  );
}

function rounds(race, watch) {
  return h(
    "div",
    { class: "race-rounds" },
    byRound(race.pairs).map((pairs, round) =>
      h(
        "section",
        {},
        h("h3", {}, `Round ${round + 1}`),
        h(
          "ol",
          {},
          pairs.map((pair) => h("li", {}, card(pair, watch))),
        ),
      ),
    ),
  );
}
