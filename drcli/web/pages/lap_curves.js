// Curves along one or two laps, over time or progress, with a cursor at the step that is shown.

import { h, number } from "/dom.js";
import { ink } from "/theme_colors.js";

const HEIGHT = 150;

/**
 * @param {{title: string, unit: string, digits?: number, seek: function(number): void}} spec seek gets the x of a click.
 * @returns element; update(laps) with [{name, color, x, lines: [{name, values, dash?}]}]; moveTo(x, readings).
 */
export function lapCurve({ title, unit, digits = 2, seek }, signal) {
  const place = h("div", { class: "plot lap-plot" }),
    readout = h("span", { class: "readout" });
  const element = h(
    "figure",
    { class: "chart lap-chart" },
    h("figcaption", {}, h("strong", {}, title), " ", readout),
    place,
  );
  const cursor = h("div", { class: "lap-cursor" });
  place.style.setProperty("min-height", `${HEIGHT}px`);
  let plot = null,
    laps = [],
    where = 0,
    xName = "time";

  function build() {
    plot?.destroy();
    plot = null;
    if (!laps.length || !place.isConnected) return;
    const tables = laps.map((lap) => [lap.x, ...lap.lines.map((line) => line.values)]);
    const data = tables.length > 1 ? uPlot.join(tables) : tables[0];
    const axis = {
      stroke: ink("quiet"),
      grid: { stroke: ink("line"), width: 1 },
      ticks: { stroke: ink("line") },
      font: "12px system-ui",
    };
    plot = new uPlot(
      {
        width: Math.max(place.clientWidth, 200),
        height: HEIGHT,
        legend: { show: false },
        cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
        scales: { x: { time: false } },
        axes: [
          {
            ...axis,
            size: 30,
            values: (_, ticks) =>
              ticks.map(
                (tick) => `${number(tick, tick % 1 ? 1 : 0)} ${xName === "time" ? "s" : "%"}`,
              ),
          },
          { ...axis, size: 52 },
        ],
        series: [
          {},
          ...laps.flatMap((lap) =>
            lap.lines.map((line) => ({
              label: line.name,
              spanGaps: true,
              stroke: ink(lap.color),
              width: line.dash ? 1 : 2,
              dash: line.dash,
              points: { show: false },
            })),
          ),
        ],
      },
      data,
      place,
    );
    plot.over.append(cursor);
    plot.over.addEventListener("click", (event) => seek(plot.posToVal(event.offsetX, "x")));
    mark();
  }

  function mark() {
    if (plot)
      cursor.style.setProperty(
        "transform",
        `translateX(${Math.round(plot.valToPos(where, "x"))}px)`,
      );
  }

  const resize = new ResizeObserver(() => {
    if (plot && place.clientWidth) {
      plot.setSize({ width: place.clientWidth, height: HEIGHT });
      mark();
    } else if (!plot) build();
  });
  resize.observe(place);
  addEventListener("themechange", build, { signal });
  signal.addEventListener(
    "abort",
    () => {
      resize.disconnect();
      plot?.destroy();
      plot = null;
    },
    { once: true },
  );
  return {
    element,
    update(shown, over = "time") {
      laps = shown;
      xName = over;
      build();
    },
    moveTo(x, readings) {
      where = x;
      mark();
      readout.textContent = readings
        .map(({ name, value }) => `${name} ${number(value, digits, unit)}`)
        .join(", ");
    },
  };
}
