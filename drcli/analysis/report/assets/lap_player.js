// The controls of the map: what is shown, in which colours, and laps that can be played.

function startMap(room) {
  const map = unpackMap(data.map);
  map.first = map.laps.first;
  const find = (name) => room.querySelector(`[data-part="${name}"]`);
  const canvas = find("canvas"),
    ctx = canvas.getContext("2d");
  const what = find("what"),
    paint = find("paint"),
    iteration = find("iteration");
  const time = find("time"),
    play = find("play"),
    speed = find("speed"),
    ends = find("ends");
  const camera = new Camera(map.bounds);
  const iterations = [...new Set(map.laps.iteration)].filter((n) => n >= 0).sort((a, b) => a - b);
  const state = {
    laps: [],
    hidden: new Set(),
    focus: -1,
    now: 0,
    most: 0,
    playing: false,
    last: 0,
  };
  iteration.max = String(Math.max(iterations.length - 1, 0));
  iteration.value = iteration.max;

  const period = () => (what.value.startsWith("steps-") ? Number(what.value.slice(6)) : -1);
  const label = (lap) => {
    const group = map.laps.iteration[lap];
    return group >= 0
      ? `iteration ${group}, episode ${map.laps.episode[lap]}`
      : `evaluation, trial ${map.laps.episode[lap] + 1}`;
  };
  /** The name of the colour of a lap: fast and bad ones can be told apart where both are shown. */
  const ink = (lap) => {
    if (what.value === "both") {
      const place = map.groups.fastest.indexOf(lap);
      return place >= 0 ? FAST_COLORS[place % 5] : WORST_COLORS[map.groups.worst.indexOf(lap) % 5];
    }
    return LAP_COLORS[Math.max(state.laps.indexOf(lap), 0) % LAP_COLORS.length];
  };
  const ownColors = () => paint.value === "lap" || paint.value === "visits";

  function chosenLaps() {
    if (what.value === "iteration") {
      const wanted = iterations[Number(iteration.value)];
      return [...map.laps.iteration.keys()].filter((lap) => map.laps.iteration[lap] === wanted);
    }
    return map.groups[what.value] || [];
  }

  /** The step of a lap at a time: the last one that is not later. */
  function stepAt(lap, seconds) {
    let low = map.first[lap],
      high = map.first[lap + 1] - 1;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (map.steps.time[middle] <= seconds) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  /** Position and heading between two steps. */
  function poseAt(lap, seconds) {
    const s = map.steps,
      i = stepAt(lap, seconds);
    const j = Math.min(i + 1, map.first[lap + 1] - 1);
    const gap = s.time[j] - s.time[i];
    const part = gap > 0 ? Math.min(Math.max((seconds - s.time[i]) / gap, 0), 1) : 0;
    const turn = ((s.yaw[j] - s.yaw[i] + 540) % 360) - 180;
    return [
      s.x[i] + part * (s.x[j] - s.x[i]),
      s.y[i] + part * (s.y[j] - s.y[i]),
      s.yaw[i] + part * turn,
    ];
  }

  function choose() {
    state.laps = chosenLaps();
    state.hidden.clear();
    state.focus = state.laps.length ? state.laps[0] : -1;
    state.most = Math.max(0, ...state.laps.map((lap) => map.steps.time[map.first[lap + 1] - 1]));
    state.now = state.most;
    state.playing = false;
    time.max = state.most.toFixed(2);
    find("iteration-room").hidden = what.value !== "iteration";
    find("player").hidden = !state.laps.length;
    for (const option of paint.options) {
      option.disabled = option.value === (state.laps.length ? "visits" : "lap");
    }
    if (paint.selectedOptions[0].disabled) paint.value = state.laps.length ? "lap" : "reward";
    iteration.setAttribute("aria-valuetext", `iteration ${iterations[Number(iteration.value)]}`);
    find("iteration-number").textContent = String(iterations[Number(iteration.value)]);
    listLaps();
    show();
  }

  function listLaps() {
    const body = find("laps-room").querySelector("tbody");
    body.replaceChildren(
      ...state.laps.map((lap) => {
        const tick = make("input", { type: "checkbox", checked: "" });
        const swatch = make("span", { class: "swatch dots" });
        swatch.style.background = `var(${ink(lap)})`;
        tick.addEventListener("change", () => {
          if (tick.checked) state.hidden.delete(lap);
          else state.hidden.add(lap);
          show();
        });
        const follow = make("input", {
          type: "radio",
          name: "followed",
          "aria-label": `Read the numbers of ${label(lap)}`,
        });
        follow.checked = lap === state.focus;
        follow.addEventListener("change", () => {
          state.focus = lap;
          show();
        });
        const cell = (text) => make("td", { class: "number" }, text);
        const group = map.laps.iteration[lap];
        const short =
          group >= 0 ? ` ${map.laps.episode[lap]}` : ` trial ${map.laps.episode[lap] + 1}`;
        const name = make("label", { class: "key", title: label(lap) }, tick, " ", swatch, short);
        const status = map.statuses[map.laps.status[lap]].replaceAll("_", " ");
        return make(
          "tr",
          {},
          make("td", {}, name),
          cell(group >= 0 ? String(group) : "–"),
          make("td", {}, follow),
          cell(`${shown(map.laps.progress[lap], 1)} %`),
          cell(`${shown(map.laps.time[lap], 2)} s`),
          cell(shown(map.laps.reward[lap])),
          make("td", {}, status),
        );
      }),
    );
    find("laps-room").hidden = !state.laps.length;
  }

  function shownLaps() {
    return state.laps.filter((lap) => !state.hidden.has(lap));
  }

  function wantedEnds() {
    if (!ends.checked) return [];
    const all = [...map.ends.x.keys()];
    if (state.laps.length) {
      const numbers = new Set(shownLaps().map((lap) => map.laps.id[lap]));
      return all.filter((i) => numbers.has(map.ends.id[i]));
    }
    return period() === 0 ? all : all.filter((i) => map.ends.period[i] === period());
  }

  function draw() {
    const width = room.clientWidth;
    if (!width) return;
    const height = camera.height(width, Math.max(260, Math.min(innerHeight * 0.72, 640)));
    const dots = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * dots) || canvas.height !== Math.round(height * dots)) {
      canvas.width = Math.round(width * dots);
      canvas.height = Math.round(height * dots);
      canvas.style.height = `${height}px`;
    }
    camera.fit(width, height);
    ctx.setTransform(dots, 0, 0, dots, 0, 0);
    ctx.clearRect(0, 0, width, height);
    drawRoad(ctx, camera, map, color);
    if ((period() >= 0 && !ownColors()) || paint.value === "visits") {
      drawCells(ctx, camera, map, Math.max(period(), 0), paint.value);
    }
    drawBorders(ctx, camera, map, color);
    drawWaypoints(ctx, camera, map, color);
    const laps = shownLaps(),
      many = laps.length > 6;
    for (const lap of laps) {
      const last = map.first[lap + 1] - 1;
      if (state.now < state.most) {
        drawLap(ctx, camera, map, lap, last, color("--faint") + "66", null, 1.2);
      }
      drawLap(
        ctx,
        camera,
        map,
        lap,
        stepAt(lap, state.now),
        color(ink(lap)),
        ownColors() ? null : paint.value,
        many ? 1.6 : 2.6,
      );
    }
    drawEnds(ctx, camera, map, wantedEnds());
    if (laps.length && (state.playing || state.now < state.most)) {
      for (const lap of laps)
        drawCar(ctx, camera, ...poseAt(lap, state.now), color(ink(lap)), color);
    } else if (laps.includes(state.focus) && laps.length > 1) {
      drawCar(ctx, camera, ...poseAt(state.focus, state.now), color(ink(state.focus)), color);
    }
  }

  function show() {
    draw();
    time.value = String(state.now);
    time.setAttribute("aria-valuetext", `${state.now.toFixed(1)} seconds`);
    play.textContent = state.playing ? "Pause" : "Play";
    readNumbers();
    drawScale();
  }

  function readNumbers() {
    const out = find("readout");
    if (state.focus < 0) {
      out.textContent = "";
      return;
    }
    out.textContent = stepText(state.focus, stepAt(state.focus, state.now));
  }

  function stepText(lap, i) {
    const s = map.steps;
    return (
      `${label(lap)} at ${shown(s.time[i], 1)} s: ` +
      `${shown(s.driven[i], 1)} m/s (requested ${shown(s.speed[i], 1)}), steering ${shown(s.steering[i], 0)}°, ` +
      `slip ${shown(s.slip[i], 0)}°, reward ${shown(s.reward[i])}, ` +
      `progress ${shown(s.progress[i], 1)} %`
    );
  }

  /** What is known of the place under the pointer: the nearest step, or the cell. */
  function readPlace(px, py) {
    let best = 14 * 14,
      found = null;
    const near = (x, y, take) => {
      const far = (camera.x(x) - px) ** 2 + (camera.y(y) - py) ** 2;
      if (far < best) [best, found] = [far, take];
    };
    for (const lap of shownLaps()) {
      for (let i = map.first[lap]; i < map.first[lap + 1]; i++) {
        near(map.steps.x[i], map.steps.y[i], [lap, i]);
      }
    }
    if (found) {
      find("readout").textContent = stepText(...found);
      return;
    }
    if (period() < 0) return;
    const cells = map.cells,
      values = cells.periods[period()];
    for (let i = 0; i < cells.x.length; i++) {
      if (values.visits[i] > 0) near(cells.x[i], cells.y[i], i);
    }
    if (found === null) return;
    const number = (name, decimals) => shown(values[name][found], decimals);
    find("readout").textContent =
      `Here, mean of ${number("visits", 0)} steps: ` +
      `reward ${number("reward")}, ${number("driven", 1)} m/s (requested ${number("speed", 1)}), ` +
      `steering ${number("steering", 0)}°, slip ${number("slip", 0)}°`;
  }

  function drawScale() {
    const bar = find("bar"),
      inks = bar.getContext("2d");
    const keys = find("keys");
    const key = (name, shade) => {
      const swatch = make("span", { class: "swatch dots" });
      swatch.style.background = `var(${shade})`;
      return make("span", { class: "key" }, swatch, name.replaceAll("_", " "));
    };
    const present = new Set(wantedEnds().map((i) => map.statuses[map.ends.status[i]]));
    keys.replaceChildren(...[...present].map((name) => key(name, END_COLORS[name] || OTHER_END)));
    const scaled = paint.value !== "lap";
    find("scale").hidden = !scaled;
    if (!scaled) return;
    const { low, high, colors } = colorScale(map, paint.value);
    colors.forEach((shade, i) => {
      inks.fillStyle = shade;
      inks.fillRect((i * bar.width) / 64, 0, bar.width / 64 + 1, bar.height);
    });
    const [unit, left, right] = map.units[paint.value];
    find("low").textContent = `${shown(low)}${unit}${left}`;
    find("high").textContent = `${shown(high)}${unit}${right}`;
  }

  function frame(now) {
    if (!state.playing) return;
    state.now += ((now - state.last) / 1000) * Number(speed.value);
    state.last = now;
    if (state.now >= state.most) {
      state.now = state.most;
      state.playing = false;
    }
    show();
    requestAnimationFrame(frame);
  }

  function toggle() {
    if (!state.laps.length) return;
    if (!state.playing && state.now >= state.most) state.now = 0;
    state.playing = !state.playing;
    state.last = performance.now();
    show();
    if (state.playing) requestAnimationFrame(frame);
  }

  function moveTo(seconds) {
    state.playing = false;
    state.now = Math.min(Math.max(seconds, 0), state.most);
    show();
  }

  /** Moves by steps of the lap whose numbers are read: they may be any time apart. */
  function moveBy(steps) {
    if (state.focus < 0) return;
    const times = map.steps.time,
      here = stepAt(state.focus, state.now);
    const between = steps < 0 && state.now > times[here] ? 1 : 0;
    const first = map.first[state.focus],
      last = map.first[state.focus + 1] - 1;
    moveTo(times[Math.min(Math.max(here + steps + between, first), last)]);
  }

  function otherIteration(by) {
    if (!iterations.length) return;
    const before =
      what.value === "iteration" ? Number(iteration.value) + by : Number(iteration.value);
    what.value = "iteration";
    iteration.value = String(before);
    choose();
  }

  function zoom(factor) {
    camera.zoomBy(factor);
    canvas.style.touchAction = camera.zoom > 1 ? "none" : "pan-y";
    draw();
  }

  what.addEventListener("change", choose);
  iteration.addEventListener("input", choose);
  for (const input of [paint, ends]) input.addEventListener("change", show);
  time.addEventListener("input", () => moveTo(Number(time.value)));
  play.addEventListener("click", toggle);
  find("in").addEventListener("click", () => zoom(1.6));
  find("out").addEventListener("click", () => zoom(1 / 1.6));
  canvas.addEventListener("keydown", (event) => {
    const act = {
      " ": toggle,
      ArrowRight: () => moveBy(1),
      ArrowLeft: () => moveBy(-1),
      Home: () => moveTo(0),
      End: () => moveTo(state.most),
      PageUp: () => otherIteration(1),
      PageDown: () => otherIteration(-1),
      "+": () => zoom(1.6),
      "-": () => zoom(1 / 1.6),
    }[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons || state.playing) return;
    readPlace(event.offsetX, event.offsetY);
  });
  canvas.addEventListener("pointerdown", (event) => {
    if (camera.zoom > 1) canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!canvas.hasPointerCapture(event.pointerId)) return;
    camera.pan(event.movementX, event.movementY);
    draw();
  });
  canvas.addEventListener(
    "wheel",
    (event) => {
      if (!event.ctrlKey) return; // a plain wheel scrolls the page
      event.preventDefault();
      zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2);
    },
    { passive: false },
  );
  new ResizeObserver(draw).observe(room);
  redraws.push(() => {
    draw();
    drawScale();
  });
  choose();
}
