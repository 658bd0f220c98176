// Graphs over iterations, progress or time, drawn by uPlot from what Python described.

/** Points of all series in the order of x: one array of x, and one of y or null for each series. */
function aligned(series) {
  const points = [];
  series.forEach((one, which) => {
    const x = unpack(one.x),
      y = unpack(one.y);
    for (let i = 0; i < x.length; i++) {
      if (Number.isFinite(x[i]) && Number.isFinite(y[i])) points.push([x[i], which, y[i]]);
    }
  });
  points.sort((a, b) => a[0] - b[0]);
  const columns = [[], ...series.map(() => [])];
  let last = -1;
  for (const [x, which, y] of points) {
    if (last < 0 || columns[0][last] !== x || columns[which + 1][last] !== null) {
      columns.forEach((column) => column.push(null));
      last += 1;
      columns[0][last] = x;
    }
    columns[which + 1][last] = y;
  }
  return columns;
}

/** The row next to a given one in which a series has a value. */
function nearestRow(column, xs, row) {
  let below = row,
    above = row;
  while (below >= 0 && column[below] === null) below--;
  while (above < column.length && column[above] === null) above++;
  if (below < 0) return above < column.length ? above : null;
  if (above >= column.length) return below;
  return xs[row] - xs[below] <= xs[above] - xs[row] ? below : above;
}

/** A number beside an axis: of large ones, thousands or millions. */
function tickText(value) {
  const size = Math.abs(value);
  if (size >= 1e6 && size < 1e12) return `${shown(value / 1e6)} M`;
  return size >= 1e4 && size < 1e6 ? `${shown(value / 1e3)} k` : shown(value);
}

function padded(u, low, high) {
  if (low === null || high === null) return [0, 1];
  const span = high - low || Math.abs(high) || 1;
  const start = low >= 0 && low < 0.4 * span ? 0 : low - 0.06 * span;
  return [start, high + 0.06 * span];
}

function seriesOptions(one) {
  const ink = () => color(one.color);
  const common = { label: one.name, scale: one.axis, show: one.on, stroke: ink, spanGaps: true };
  if (one.kind === "line") {
    return { ...common, width: 2.5, points: { show: one.x_count < 3, size: 6, fill: ink } };
  }
  return {
    ...common,
    paths: () => null,
    points: { show: true, size: one.kind === "marks" ? 7 : 4.5, width: 0, stroke: ink, fill: ink },
  };
}

function readoutText(u, graph, row) {
  const parts = [];
  graph.series.forEach((one, i) => {
    const index = u.series[i + 1].show ? nearestRow(u.data[i + 1], u.data[0], row) : null;
    if (index === null) return;
    const far = Math.abs(u.data[0][index] - u.data[0][row]);
    if (far > graph.near) return;
    parts.push(`${one.name} ${shown(u.data[i + 1][index], one.decimals)}`);
  });
  const x = u.data[0][row];
  const at = graph.whole_x ? Math.round(x) : shown(x, graph.x_decimals);
  return `${graph.x_label} ${at}: ${parts.join(" · ")}`;
}

function buildGraph(figure, graph) {
  const room = figure.querySelector(".plot");
  const readout = figure.querySelector(".readout");
  const columns = aligned(graph.series);
  graph.series.forEach((one, i) => {
    one.x_count = columns[i + 1].filter((value) => value !== null).length;
  });
  const ink = () => color("--quiet"),
    grid = () => color("--line");
  const font = "12px system-ui, sans-serif";
  const axis = (scale, side, extra) => ({
    scale,
    side,
    stroke: ink,
    font,
    gap: 4,
    size: (u, values) => Math.max(34, 14 + 7 * Math.max(0, ...(values || []).map((v) => v.length))),
    grid: { show: side === 3 || scale === "x", stroke: grid, width: 1 },
    ticks: { stroke: grid, width: 1, size: 4 },
    values: (u, values) => values.map((value) => (value === null ? "" : tickText(value))),
    ...extra,
  });
  const used = new Set(graph.series.map((one) => one.axis));
  const axes = [
    axis("x", 2, {
      size: 30,
      space: 56,
      incrs: graph.whole_x ? WHOLE_STEPS : undefined,
    }),
  ];
  const scales = { x: { time: false } };
  for (const name of ["left", "right"]) {
    if (!used.has(name)) continue;
    const range = graph[`${name}_range`];
    scales[name] = { auto: true, range: range ? () => range : padded };
    axes.push(axis(name, name === "left" ? 3 : 1));
  }
  const zoomOut = make("button", { type: "button", hidden: "" }, "Show all");
  const height = () => (room.clientWidth < 480 ? 210 : graph.height);
  const u = new uPlot(
    {
      width: Math.max(room.clientWidth, 200),
      height: height(),
      scales,
      axes,
      padding: [10, used.has("right") ? 0 : 12, 0, 0],
      legend: { show: false },
      cursor: {
        dataIdx: (plot, which, row) => nearestRow(plot.data[which], plot.data[0], row) ?? row,
        drag: { x: true, y: false },
        y: false,
        points: { size: 8 },
      },
      series: [{}, ...graph.series.map(seriesOptions)],
      hooks: {
        draw: [
          (plot) => {
            const inks = { ink: color("--good"), paper: color("--paper") };
            graph.marks.forEach((mark) => drawMark(plot, mark.x, mark.label, inks));
          },
        ],
        setCursor: [
          (plot) => {
            if (plot.cursor.idx === null || plot.cursor.left < 0) return;
            readout.textContent = readoutText(plot, graph, plot.cursor.idx);
          },
        ],
        setScale: [
          (plot, key) => {
            if (key !== "x" || !plot.data[0].length) return;
            const xs = plot.data[0],
              { min, max } = plot.scales.x;
            zoomOut.hidden = min <= xs[0] && max >= xs[xs.length - 1];
          },
        ],
      },
    },
    columns,
    room,
  );
  zoomOut.addEventListener("click", () => {
    const xs = u.data[0];
    u.setScale("x", { min: xs[0], max: xs[xs.length - 1] });
    room.focus();
  });
  figure.querySelector(".keys").append(zoomOut);
  for (const tick of figure.querySelectorAll(".keys input")) {
    const follow = () => u.setSeries(Number(tick.dataset.series) + 1, { show: tick.checked });
    tick.addEventListener("change", follow);
    // Somebody may have used the switch before the graph was drawn.
    if (u.series[Number(tick.dataset.series) + 1].show !== tick.checked) follow();
  }
  let row = -1;
  room.addEventListener("keydown", (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by || !u.data[0].length) return;
    event.preventDefault();
    const line = graph.series.findIndex((one, i) => one.kind === "line" && u.series[i + 1].show);
    do row += by;
    while (line >= 0 && u.data[line + 1][row] === null);
    row = Math.min(Math.max(row, 0), u.data[0].length - 1);
    u.setCursor({ left: u.valToPos(u.data[0][row], "x"), top: 10 });
  });
  new ResizeObserver(() => {
    if (room.clientWidth && room.clientWidth !== u.width) {
      u.setSize({ width: room.clientWidth, height: height() });
    }
  }).observe(room);
  redraws.push(() => u.redraw(true, true));
}

function startGraphs() {
  for (const figure of document.querySelectorAll("figure[data-graph]")) {
    const graph = data.graphs[figure.dataset.graph];
    // Those far down the page are drawn when they come near.
    const seen = new IntersectionObserver(
      (entries) => {
        if (!entries.some((entry) => entry.isIntersecting)) return;
        seen.disconnect();
        attempt(figure, () => buildGraph(figure, graph));
      },
      { rootMargin: "400px" },
    );
    seen.observe(figure);
  }
}
