// A race for a projector: leaderboard, who drives now, what comes next, the last result, and the winner.

import { andResets, failure, fill, h, number } from "/dom.js";
import { pairsView } from "/race_pairs.js";
import { gapText, raceLink, waitText } from "/race_words.js";
import { follow } from "/socket.js";

export const title = "Race night";

const SLIDE_S = 12;
const LAST_S = 15;
const NARROW = "(max-width: 900px)";

export function show(main, [id], { signal }) {
  const heading = h("h1", {}, "Race night"),
    facts = h("p", { class: "night-facts" }),
    stage = h("section", { class: "night-stage", "aria-label": "Leaderboard" });
  const now = h("section", { class: "night-now", "aria-label": "Driven now" }),
    next = h("section", { class: "night-next", "aria-label": "Next" });
  const last = h("section", {
    class: "night-last",
    "aria-live": "polite",
    "aria-label": "Last result",
    hidden: true,
  });
  const trouble = h("div", { role: "status" });
  const pause = h(
    "button",
    { type: "button", "aria-pressed": "false", click: () => setPaused(!paused) },
    "Pause",
  );
  const full = h("button", { type: "button", click: fullScreen }, "Full screen");
  const bar = h(
    "p",
    { class: "night-bar actions" },
    h("a", { class: "button", href: raceLink(id) }, "Back to the race"),
    h("button", { type: "button", click: () => turn(-1) }, "Previous"),
    h("button", { type: "button", click: () => turn(1) }, "Next"),
    pause,
    full,
    h("span", { class: "night-keys" }, "Keys: F full screen, arrows previous and next, P pause"),
  );
  const night = h(
    "div",
    { class: "night" },
    h("header", {}, heading, facts),
    trouble,
    h("div", { class: "night-body" }, stage, h("div", { class: "night-side" }, now, next)),
    last,
    bar,
  );
  fill(main, night);
  document.documentElement.classList.add("night-on");

  let race = null,
    drawn = "",
    slide = 0,
    paused = false,
    scene = null,
    liveTopic = "",
    live = null,
    lastKey = null,
    lastTimer = 0,
    ranks = new Map();
  const narrow = matchMedia(NARROW);

  follow(
    `race:${id}`,
    (value) => {
      if (value.error) {
        drawn = "";
        fill(trouble, failure(value.error));
        return;
      }
      fill(trouble);
      const text = JSON.stringify(value);
      if (text === drawn) return;
      const before = race;
      drawn = text;
      race = value;
      document.title = `${race.rules.name} – Race night`;
      followLive();
      announce(before);
      if (race.winner && !before?.winner) slide = 0;
      draw();
    },
    signal,
  );

  function followLive() {
    const topic =
      race.live && race.moments.driving ? `live:${race.live.run_id}:${race.live.worker}:scene` : "";
    if (topic === liveTopic) return;
    live?.abort();
    liveTopic = topic;
    scene = null;
    if (!topic) return;
    live = new AbortController();
    follow(
      topic,
      (data) => {
        scene = data.scene ?? data;
        if (Array.isArray(scene.cars)) drawNow();
      },
      live.signal,
    );
  }

  /** Rows that fit: what the screen has, but never so many that they become small. */
  const rowsOnSlide = () => (narrow.matches ? 99 : 8);

  function slides() {
    const found = [];
    if (race.winner) found.push("winner");
    for (let first = 0; first < Math.max(1, race.leaderboard.length); first += rowsOnSlide())
      found.push(first);
    if (race.pairs.length) found.push("pairs");
    return found;
  }

  function turn(by) {
    if (!race) return;
    const count = slides().length;
    slide = (slide + by + count) % count;
    draw();
    restartClock();
  }

  let clock = 0;
  function restartClock() {
    clearInterval(clock);
    if (!paused)
      clock = setInterval(() => {
        if (race && slides().length > 1) {
          slide = (slide + 1) % slides().length;
          draw();
        }
      }, SLIDE_S * 1000);
  }

  function setPaused(value) {
    paused = value;
    pause.setAttribute("aria-pressed", String(paused));
    restartClock();
  }

  async function fullScreen() {
    try {
      if (document.fullscreenElement) await document.exitFullscreen();
      else await night.requestFullscreen();
    } catch {
      fill(
        trouble,
        h("p", {}, "This browser does not allow full screen here; its own key is often F11."),
      );
    }
  }

  function draw() {
    const { rules, words } = race,
      all = slides();
    slide = Math.min(slide, all.length - 1);
    heading.textContent = rules.name;
    facts.textContent = `${words.place}. ${words.decides}`;
    const shown = all[slide];
    night.classList.toggle("night-alone", shown === "winner" || shown === "pairs");
    if (shown === "winner") fill(stage, winner());
    else if (shown === "pairs")
      fill(
        stage,
        h("h2", {}, rules.pairing === "bracket" ? "Bracket" : "Pairs"),
        h(
          "div",
          { class: "night-pairs" },
          pairsView(
            { ...race, pairs: race.pairs.map((pair) => ({ ...pair, videos: [] })) },
            () => {},
          ),
        ),
      );
    else fill(stage, board(shown));
    if (shown === "pairs" && !narrow.matches) fit(stage.querySelector(".night-pairs"));
    if (all.length > 1)
      stage.append(
        h(
          "p",
          { class: "night-dots", "aria-hidden": "true" },
          all.map((each, k) => h("span", { class: k === slide ? "on" : null })),
        ),
      );
    drawNow();
    drawNext();
  }

  /** Smaller text until all pairs are seen; many of them are scrolled rather than made unreadable. */
  function fit(box) {
    for (let share = 1; share > 0.4; share -= 0.1) {
      box.style.setProperty("--fit", share.toFixed(1));
      if (box.scrollHeight <= box.clientHeight + 1 && box.scrollWidth <= box.clientWidth + 1)
        return;
    }
  }

  function score(row) {
    if (race.rules.race_type === "HEAD_TO_MODEL")
      return `${number(row.points ?? 0, row.points % 1 ? 1 : 0)} ${row.points === 1 ? "point" : "points"}`;
    return row.score_s === null ? row.laps_text : row.score_text;
  }

  function board(first) {
    const rows = race.leaderboard.slice(first, first + rowsOnSlide());
    if (!rows.length)
      return h(
        "p",
        { class: "night-empty" },
        race.submissions.length
          ? "Nobody has driven yet."
          : race.state === "open"
            ? "Submit your model!"
            : "Nobody has submitted a model.",
      );
    const inPairs = race.rules.race_type === "HEAD_TO_MODEL";
    const list = h(
      "ol",
      { class: "night-board", start: String(first + 1) },
      rows.map((row) => {
        const rank = row.rank === null ? "–" : String(row.rank),
          moved = ranks.size && ranks.get(row.racer) !== row.rank;
        return h(
          "li",
          { class: `${row.rank === 1 ? "first" : ""}${moved ? " moved" : ""}` },
          h("span", { class: "night-rank" }, rank),
          h("span", { class: "night-racer" }, row.racer),
          h("span", { class: "night-score" }, score(row)),
          h(
            "span",
            { class: "night-gap" },
            inPairs
              ? `best lap ${row.best_lap_text}`
              : row.rank === null
                ? "not qualified"
                : gapText(row),
          ),
        );
      }),
    );
    ranks = new Map(race.leaderboard.map((row) => [row.racer, row.rank]));
    return list;
  }

  function winner() {
    const first = race.leaderboard[0];
    return h(
      "div",
      { class: "night-winner", role: "status" },
      h("p", {}, "Winner"),
      h("p", { class: "night-winner-name" }, race.winner),
      h("p", { class: "night-winner-score" }, score(first)),
      race.leaderboard.length > 1
        ? h(
            "p",
            { class: "night-podium" },
            race.leaderboard
              .slice(1, 3)
              .filter((row) => row.rank)
              .map((row) => `${row.rank}. ${row.racer} ${score(row)}`)
              .join("   "),
          )
        : null,
    );
  }

  function progressOf(car) {
    if (!scene || !Array.isArray(scene.cars)) return null;
    const index = (scene.racers ?? []).findIndex((racer) =>
      racer.model?.includes(`-${car.submission}/`),
    );
    return (
      scene.cars.find((each) => each.racer === index) ??
      (race.moments.driving.cars.length === 1 ? (scene.cars[0] ?? null) : null)
    );
  }

  function drawNow() {
    const driving = race.moments.driving;
    if (!driving) {
      const said =
        race.state === "finished"
          ? "The race is over."
          : race.queue.length
            ? race.runner
              ? "The next car goes to the start."
              : `${waitText(race.queue.length)}. Nobody is driving the queue.`
            : "Nobody is driving.";
      fill(now, h("h2", {}, "Now"), h("p", { class: "quiet" }, said));
      return;
    }
    fill(
      now,
      h("h2", {}, "Now"),
      driving.cars.map((car) => {
        const found = progressOf(car),
          laps = race.rules.max_laps;
        const share = found
          ? Math.min(100, (100 * found.laps + Math.max(0, found.progress)) / laps)
          : null;
        const bar = h("progress", {
          max: "100",
          "aria-label": `Progress of ${car.racer}`,
          value: share === null ? null : share,
        });
        if (share === null) bar.removeAttribute("value");
        return h(
          "div",
          { class: "night-driver" },
          h("p", { class: "night-driver-name" }, car.racer),
          found ? bar : null,
          h(
            "p",
            { class: "night-driver-facts" },
            found
              ? `Lap ${Math.min(laps, found.laps + 1)} of ${laps}, ${number(Math.max(0, found.progress))} %, ${number(found.lap_s, 1, "s")}${andResets(found.resets)}`
              : sinceText(driving.began_at),
          ),
        );
      }),
    );
  }

  const sinceText = (began) => {
    const seconds = Math.max(0, Math.round(Date.now() / 1000 - began));
    return `has driven for ${seconds < 90 ? `${seconds} s` : `${Math.round(seconds / 60)} min`}`;
  };
  const ticking = setInterval(() => {
    if (race?.moments.driving && !(scene && Array.isArray(scene.cars))) drawNow();
  }, 1000);

  function drawNext() {
    const entries = new Map(race.submissions.map((entry) => [entry.submission, entry]));
    const names = race.queue.map((run) =>
      run
        .split("+")
        .map((each) => entries.get(each)?.racer ?? each)
        .join(" – "),
    );
    const most = narrow.matches ? names.length : 4;
    fill(
      next,
      h("h2", {}, "Next"),
      names.length
        ? h(
            "ol",
            {},
            names.slice(0, most).map((name) => h("li", {}, name)),
          )
        : h(
            "p",
            { class: "quiet" },
            race.state === "open" ? "The queue is empty: submit a model." : "The queue is empty.",
          ),
      names.length > most
        ? h("p", { class: "quiet" }, `and ${number(names.length - most)} more`)
        : null,
    );
  }

  /** A result that has come since the page was opened, for some seconds. */
  function announce(before) {
    const found = race.moments.last;
    const key = found?.key ?? "";
    if (before && key && key !== lastKey) {
      const cars = found.cars.map(
        (car) => `${car.racer}: ${found.state === "failed" ? "the run has failed" : car.text}`,
      );
      const places = found.cars
        .map((car) => race.leaderboard.find((row) => row.submission === car.submission))
        .filter((row) => row?.rank);
      fill(
        last,
        h(
          "p",
          {},
          h("strong", {}, "Last result  "),
          cars.join("   "),
          places.length === 1 ? h("strong", {}, `   Rank ${places[0].rank}`) : null,
        ),
      );
      last.hidden = false;
      last.classList.remove("in");
      void last.offsetWidth; // begins the animation again
      last.classList.add("in");
      clearTimeout(lastTimer);
      lastTimer = setTimeout(() => {
        last.hidden = true;
      }, LAST_S * 1000);
    }
    lastKey = key;
  }

  addEventListener(
    "keydown",
    (event) => {
      if (
        event.ctrlKey ||
        event.metaKey ||
        event.altKey ||
        event.target.closest?.("input, select, textarea, dialog")
      )
        return;
      const steps = { ArrowRight: 1, ArrowLeft: -1, PageDown: 1, PageUp: -1 };
      if (event.key in steps) turn(steps[event.key]);
      else if (event.key === "f" || event.key === "F") fullScreen();
      else if (event.key === "p" || event.key === "P") setPaused(!paused);
      else return;
      event.preventDefault();
    },
    { signal },
  );
  narrow.addEventListener(
    "change",
    () => {
      if (race) draw();
    },
    { signal },
  );
  let resting = 0;
  const wake = () => {
    night.classList.remove("night-still");
    clearTimeout(resting);
    resting = setTimeout(() => night.classList.add("night-still"), 4000);
  };
  for (const kind of ["pointermove", "keydown", "focusin"])
    addEventListener(kind, wake, { signal });
  document.addEventListener(
    "fullscreenchange",
    () => {
      full.textContent = document.fullscreenElement ? "Leave full screen" : "Full screen";
    },
    { signal },
  );
  wake();
  restartClock();
  signal.addEventListener(
    "abort",
    () => {
      clearInterval(clock);
      clearInterval(ticking);
      clearTimeout(lastTimer);
      clearTimeout(resting);
      live?.abort();
      document.documentElement.classList.remove("night-on");
      if (document.fullscreenElement) document.exitFullscreen().catch(() => {});
    },
    { once: true },
  );
}
