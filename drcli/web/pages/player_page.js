// Plays stored episodes step by step, one lap or two side by side.

import { failure, fill, h, number } from "/dom.js";
import { episodeChooser } from "/episode_chooser.js";
import { EpisodeData, lastAt } from "/episode_data.js";
import { episodePane } from "/episode_pane.js";
import { lapCurve } from "/lap_curves.js";
import { trackMap } from "/track_map.js";

export const title = "Episodes";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const COLORS = ["c1", "c2"];
const NAMES = ["first lap", "second lap"];
const PATHS = {
  driven_mps: ["Speed driven", "m/s"],
  speed_mps: ["Speed asked for", "m/s"],
  reward: ["Reward", ""],
  steering_deg: ["Steering", "°"],
};

const hash = (query) =>
  `#/play?${new URLSearchParams(Object.entries(query).filter(([, value]) => value !== null && value !== undefined))}`;

export async function show(main, _params, { signal, query }) {
  const asked = Object.fromEntries(query);
  const first = asked.trace
    ? { model: asked.model, trace: asked.trace, episode: asked.episode ?? "0" }
    : null;
  const second = asked.other_trace
    ? {
        model: asked.other_model ?? asked.model,
        trace: asked.other_trace,
        episode: asked.other_episode ?? "0",
      }
    : null;
  const player = h("div", { class: "player" });
  const choosers = h("div", { class: "choosers" });
  fill(
    main,
    h("h1", {}, "Episodes"),
    first
      ? null
      : h(
          "p",
          {},
          "Every stored episode of a training or an evaluation can be played step by step.",
        ),
    player,
    choosers,
  );
  const other = second && {
    other_model: second.model,
    other_trace: second.trace,
    other_episode: second.episode,
  };
  const chooseFirst = () =>
    episodeChooser(
      {
        chosen: first ?? { model: asked.model },
        action: "Play",
        link: (chosen) => hash({ ...chosen, ...other }),
      },
      signal,
    );
  const chooseSecond = () =>
    episodeChooser(
      {
        chosen: second ?? { model: asked.model, trace: asked.trace },
        action: "Compare",
        link: (chosen) =>
          hash({
            ...first,
            other_model: chosen.model,
            other_trace: chosen.trace,
            other_episode: chosen.episode,
          }),
      },
      signal,
    );
  if (!first) {
    fill(choosers, chooseFirst());
    return;
  }
  fill(
    choosers,
    folded("Choose another episode", chooseFirst),
    folded(second ? "Choose another second lap" : "Compare with a second lap", chooseSecond),
  );
  fill(
    player,
    h("p", { class: "quiet" }, "The episode is read; the first time this takes some seconds …"),
  );
  let start = null;
  const chosen = [first, second].filter(Boolean);
  try {
    const laps = [];
    for (const [k, each] of chosen.entries())
      laps.push(await EpisodeData.open(each, (kind) => start?.changed(k, kind), signal));
    if (signal.aborted) return;
    start = play(player, laps, { first, second, step: Number(asked.step) || 0 }, signal);
  } catch (error) {
    if (signal.aborted || error.name === "AbortError") return;
    fill(
      player,
      failure(error),
      h(
        "p",
        { class: "actions" },
        h(
          "button",
          { type: "button", click: () => dispatchEvent(new HashChangeEvent("hashchange")) },
          "Try again",
        ),
      ),
    );
    choosers.firstChild.open = true;
  }
}

function folded(summary, make) {
  const details = h(
    "details",
    {
      class: "folded",
      toggle: () => {
        if (details.open && details.childElementCount === 1) details.append(make());
      },
    },
    h("summary", {}, summary),
  );
  return details;
}

/** Build the player of one or two laps. */
function play(place, laps, { first, second, step }, signal) {
  const lead = laps[0];
  const state = { at: 0, over: "time", speed: 1, playing: false, color: "driven_mps" };
  const panes = laps.map((data, k) =>
    episodePane(
      data,
      { name: NAMES[k], color: COLORS[k], links: paneLinks(laps, k, first, second) },
      signal,
    ),
  );
  const map = trackMap(
    { label: "Track with the driven path and the car", pick: seekPlace },
    signal,
  );
  const curves = {
    speed: lapCurve({ title: "Speed", unit: "m/s", seek }, signal),
    steering: lapCurve({ title: "Steering", unit: "°", digits: 1, seek }, signal),
    reward: lapCurve({ title: "Reward of a step", unit: "", digits: 3, seek }, signal),
    value: lapCurve({ title: "What the critic expects", unit: "", seek }, signal),
  };
  const bar = controls(state, laps, { seek, toggle, move, setOver, restart });
  const header = document.querySelector("header.bar"); // the controls stay below it
  const measured = new ResizeObserver(() =>
    bar.element.style.setProperty("--bar-height", `${header.offsetHeight}px`),
  );
  measured.observe(header);
  signal.addEventListener("abort", () => measured.disconnect(), { once: true });
  fill(
    place,
    bar.element,
    h(
      "div",
      { class: laps.length > 1 ? "player-grid two" : "player-grid" },
      panes[0].element,
      mapPart(laps.length > 1 ? null : curvesPart()),
      panes[1]?.element ?? null,
    ),
    laps.length > 1 ? curvesPart() : null,
    keysHelp(),
  );
  map.setTrack(lead.facts.outline ?? laps[1]?.facts.outline ?? null);
  drawPaths();
  drawCurves();
  state.at = lead.lap.time_s[Math.min(Math.max(step, 0), lead.rows - 1)];
  update();

  /** The axis on which both laps are aligned: seconds, or percent of the lap. */
  function axis(data) {
    return state.over === "time" ? data.lap.time_s : data.progress;
  }
  function end() {
    return Math.max(...laps.map((data) => axis(data).at(-1)));
  }
  function rows() {
    return laps.map((data) => lastAt(axis(data), state.at));
  }

  function curvesPart() {
    return h(
      "div",
      { class: "lap-curves" },
      Object.values(curves).map((curve) => curve.element),
    );
  }

  function mapPart(below) {
    const waypoints = h("input", {
      type: "checkbox",
      change: (event) => map.showWaypoints(event.currentTarget.checked),
    });
    const color = h(
      "select",
      {
        change: () => {
          state.color = color.value;
          drawPaths();
        },
      },
      Object.entries(PATHS).map(([key, [name]]) => h("option", { value: key }, name)),
    );
    return h(
      "section",
      { class: "map-part", "aria-label": "Map" },
      map.element,
      h(
        "p",
        { class: "actions" },
        h("label", { class: "pick inline" }, h("span", {}, "Path shows"), color),
        h("label", { class: "tick" }, waypoints, h("span", {}, "Waypoint numbers")),
      ),
      below,
    );
  }

  function drawPaths() {
    const [name, unit] = PATHS[state.color];
    map.setPaths(
      laps.map(({ lap }, k) =>
        k
          ? { x: lap.x, y: lap.y, color: COLORS[k], dashed: true }
          : { x: lap.x, y: lap.y, values: lap[state.color], name, unit },
      ),
    );
  }

  function drawCurves(which = Object.keys(curves)) {
    const shown = (list) =>
      laps.map((data, k) =>
        rising(axis(data), { name: NAMES[k], color: COLORS[k], lines: list(data) }),
      );
    const made = {
      speed: ({ lap }) => [
        { name: "driven", values: lap.driven_mps },
        { name: "asked for", values: lap.speed_mps, dash: [4, 3] },
      ],
      steering: ({ lap }) => [{ name: "steering", values: lap.steering_deg }],
      reward: ({ lap }) => [{ name: "reward", values: lap.reward }],
      value: (data) => [{ name: "value", values: data.values() }],
    };
    for (const key of which) curves[key].update(shown(made[key]), state.over);
    curves.value.element.hidden = laps.every(
      (data) => data.checkpoint === null || data.values().every((value) => value === null),
    );
  }

  function update() {
    const at = rows();
    panes.forEach((pane, k) => pane.show(at[k]));
    map.setCars(
      laps.map(({ lap }, k) => ({
        x: lap.x[at[k]],
        y: lap.y[at[k]],
        yaw: lap.yaw_rad[at[k]],
        color: COLORS[k],
        name: laps.length > 1 ? String(k + 1) : "",
      })),
    );
    map.setObjects(
      lead.lap.objects.length ? lead.lap.objects[Math.min(at[0], lead.lap.objects.length - 1)] : [],
    );
    const named = (value) =>
      laps.map((data, k) => ({ name: laps.length > 1 ? NAMES[k] : "", value: value(data, at[k]) }));
    const read = (values) => named((data, row) => values(data)[row]);
    curves.speed.moveTo(
      state.at,
      read(({ lap }) => lap.driven_mps),
    );
    curves.steering.moveTo(
      state.at,
      read(({ lap }) => lap.steering_deg),
    );
    curves.reward.moveTo(
      state.at,
      read(({ lap }) => lap.reward),
    );
    if (!curves.value.element.hidden)
      curves.value.moveTo(
        state.at,
        named((data, row) => data.valueAt(row)),
      );
    bar.show(at, end());
  }

  function seek(x) {
    state.at = Math.min(Math.max(x, Math.min(...laps.map((data) => axis(data)[0]))), end());
    update();
  }

  function seekPlace(x, y) {
    const { lap } = lead;
    let best = 0,
      least = Infinity;
    lap.x.forEach((each, k) => {
      const far = Math.hypot(each - x, lap.y[k] - y);
      if (far < least) {
        least = far;
        best = k;
      }
    });
    if (least < 1) seek(axis(lead)[best]);
  }

  /** Go some steps of the first lap on, of the second one where the first has ended. */
  function move(steps) {
    stop();
    const data =
      laps.find((each) =>
        steps > 0
          ? axis(each).at(-1) > state.at
          : axis(each)[0] < state.at && axis(each).at(-1) >= state.at,
      ) ?? lead;
    const values = axis(data);
    let row = Math.min(Math.max(lastAt(values, state.at) + steps, 0), data.rows - 1);
    // Progress may stand still for some steps.
    while (row > 0 && row < data.rows - 1 && values[row] === state.at) row += Math.sign(steps);
    seek(values[row]);
  }

  function setOver(over) {
    const row = lastAt(axis(lead), state.at);
    state.over = over;
    drawCurves();
    seek(axis(lead)[row]);
  }

  function restart() {
    seek(-Infinity);
  }
  function stop() {
    if (state.playing) {
      state.playing = false;
      bar.show(rows(), end());
    }
  }

  function toggle() {
    state.playing = !state.playing;
    if (state.playing && state.at >= end() - 1e-6) restart();
    bar.show(rows(), end());
    let before = null;
    const frame = (now) => {
      if (!state.playing || signal.aborted) return;
      if (before !== null) {
        const passed = (Math.min(now - before, 250) / 1000) * state.speed;
        seek(state.over === "time" ? state.at + passed : progressAfter(lead, state.at, passed));
        if (state.at >= end() - 1e-6) {
          stop();
          return;
        }
      }
      before = now;
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  addEventListener(
    "keydown",
    (event) => {
      const tag = event.target.closest?.("input, select, textarea, dialog, .u-over");
      const slider = tag?.type === "range";
      if (
        (tag && !slider) ||
        event.ctrlKey ||
        event.metaKey ||
        event.altKey ||
        document.querySelector("dialog[open]")
      )
        return;
      const onControl = event.target.closest?.("button, a, summary");
      const actions = {
        " ": onControl ? null : toggle,
        k: toggle,
        ArrowRight: () => move(event.shiftKey ? 15 : 1),
        ArrowLeft: () => move(event.shiftKey ? -15 : -1),
        Home: restart,
        End: () => seek(Infinity),
        e: () => panes.forEach((pane) => pane.toggleExplanation()),
        "+": () => bar.faster(1),
        "-": () => bar.faster(-1),
      };
      const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
      if (!action) return;
      event.preventDefault();
      action();
    },
    { signal },
  );
  signal.addEventListener(
    "abort",
    () => {
      state.playing = false;
    },
    { once: true },
  );

  let scheduled = false,
    values = false;
  return {
    changed(_lap, kind) {
      values ||= kind === "policy";
      if (scheduled) return;
      scheduled = true;
      requestAnimationFrame(() => {
        scheduled = false;
        if (signal.aborted) return;
        if (values) drawCurves(["value"]);
        values = false;
        update();
      });
    },
  };
}

function paneLinks(laps, k, first, second) {
  const data = laps[k],
    here = Number(data.query.episode),
    count = data.facts.episodes.length;
  const of = (episode) =>
    k
      ? hash({
          ...first,
          other_model: second.model,
          other_trace: second.trace,
          other_episode: episode,
        })
      : hash({
          ...first,
          episode,
          ...(second && {
            other_model: second.model,
            other_trace: second.trace,
            other_episode: second.episode,
          }),
        });
  return [
    here > 0 ? h("a", { class: "button short", href: of(here - 1) }, "Previous episode") : null,
    here + 1 < count ? h("a", { class: "button short", href: of(here + 1) }, "Next episode") : null,
    k ? h("a", { class: "button short", href: hash(first) }, "Remove the second lap") : null,
  ];
}

function controls(state, laps, { seek, toggle, move, setOver, restart }) {
  const start = h("button", { type: "button", class: "main play", click: toggle }, "Play");
  const slider = h("input", {
    type: "range",
    min: "0",
    max: "1000",
    step: "any",
    "aria-label": "Position in the episode",
    input: () => seek(Number(slider.value)),
  });
  const speed = h(
    "select",
    {
      change: () => {
        state.speed = Number(speed.value);
      },
    },
    SPEEDS.map((each) => h("option", { value: String(each), selected: each === 1 }, `${each}×`)),
  );
  const position = h("p", { class: "position" });
  const over =
    laps.length > 1
      ? h(
          "label",
          { class: "pick inline" },
          h("span", {}, "Align by"),
          h(
            "select",
            { change: (event) => setOver(event.currentTarget.value) },
            h("option", { value: "time" }, "time"),
            h("option", { value: "progress" }, "progress"),
          ),
        )
      : null;
  const element = h(
    "div",
    { class: "player-controls", role: "group", "aria-label": "Playback" },
    h("button", { type: "button", "aria-label": "To the beginning", click: restart }, "|◀"),
    h("button", { type: "button", "aria-label": "One step back", click: () => move(-1) }, "◀"),
    start,
    h("button", { type: "button", "aria-label": "One step on", click: () => move(1) }, "▶"),
    h("label", { class: "pick inline" }, h("span", { class: "unseen" }, "Speed"), speed),
    over,
    slider,
    position,
  );
  return {
    element,
    faster(by) {
      const place = Math.min(Math.max(SPEEDS.indexOf(state.speed) + by, 0), SPEEDS.length - 1);
      state.speed = SPEEDS[place];
      speed.value = String(state.speed);
    },
    show(rows, end) {
      start.textContent = state.playing ? "Pause" : "Play";
      slider.max = String(end);
      slider.value = String(state.at);
      const text = laps
        .map(
          ({ lap }, k) =>
            `${laps.length > 1 ? `${k + 1}: ` : ""}step ${number(rows[k] + 1)} of ${number(lap.time_s.length)}, ${number(lap.time_s[rows[k]], 2)} s, ${number(lap.progress[rows[k]], 1)} %`,
        )
        .join(" · ");
      slider.setAttribute("aria-valuetext", text);
      position.textContent = text;
    },
  };
}

function keysHelp() {
  const keys = [
    ["Space or K", "play, pause"],
    ["← →", "one step"],
    ["Shift ← →", "one second"],
    ["Home, End", "beginning, end"],
    ["+ −", "faster, slower"],
    ["E", "explanation map on and off"],
  ];
  return h(
    "details",
    { class: "folded" },
    h("summary", {}, "Keys"),
    h(
      "dl",
      { class: "keys" },
      keys.map(([key, what]) => h("div", {}, h("dt", {}, h("kbd", {}, key)), h("dd", {}, what))),
    ),
  );
}

/** Progress of the lap after so many seconds more than at a progress. */
function progressAfter(data, progress, seconds) {
  const { time_s: time } = data.lap,
    row = lastAt(data.progress, progress);
  const next = Math.min(row + 1, data.rows - 1),
    gain = data.progress[next] - data.progress[row],
    span = time[next] - time[row];
  if (!(span > 0)) return progress + seconds * 5;
  return gain > 1e-6
    ? progress + (seconds / span) * gain
    : data.progress[Math.min(row + 1, data.rows - 1)] + 1e-6;
}

/** A lap whose x rises strictly, as a plot needs it. */
function rising(x, { name, color, lines }) {
  const rows = [];
  let last = -Infinity;
  x.forEach((value, k) => {
    if (value > last) {
      rows.push(k);
      last = value;
    }
  });
  return {
    name,
    color,
    x: rows.map((k) => x[k]),
    lines: lines.map((line) => ({ ...line, values: rows.map((k) => line.values[k]) })),
  };
}
