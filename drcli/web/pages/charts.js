// Curves by uPlot: sizes are reserved, colours follow the theme, values are read below the curve.

import { h, number } from "/dom.js";
import { WHOLE_STEPS, drawMark } from "/graph_parts.js";
import { ink } from "/theme_colors.js";

/**
 * A chart that can be updated.
 * @param {{title: string, hint?: string, x: string, height?: number, series: {name: string, color: string, unit?: string, digits?: number, dots?: boolean, faint?: boolean, axis?: "right", dash?: number[]}[], limits?: Object, axes?: {left?: string, right?: string}, mark?: function(): ?{x: number, text: string}, readout?: function(number): string}} spec
 *   `mark` is a vertical line with a word; `readout` is what is said about a point instead of its numbers.
 * @returns {{element: HTMLElement, update: function(number[][]): void}} update takes x and one list per series.
 */
export function chart(spec, signal) {
  const place = h("div", { class: "plot" });
  const readout = h("p", { class: "readout" }, " ");
  const shown = spec.series.map(() => true);
  const toggles = h(
    "div",
    { class: "toggles", role: "group", "aria-label": `Curves of ${spec.title}` },
    spec.series.map((each, k) =>
      h(
        "button",
        {
          type: "button",
          class: "toggle",
          "aria-pressed": "true",
          click: (event) => {
            shown[k] = !shown[k];
            event.currentTarget.setAttribute("aria-pressed", String(shown[k]));
            plot?.setSeries(k + 1, { show: shown[k] });
          },
        },
        h("span", { class: `swatch ink-${each.color}` }),
        each.name,
      ),
    ),
  );
  const element = h(
    "figure",
    { class: "chart" },
    h("figcaption", {}, h("strong", {}, spec.title), spec.hint ? ` ${spec.hint}` : null),
    toggles,
    place,
    readout,
  );
  place.style.setProperty("min-height", `${spec.height ?? 240}px`);
  let plot = null,
    data = [[], ...spec.series.map(() => [])];

  const read = (index) => {
    const at = index ?? data[0].length - 1;
    if (at < 0) return;
    if (spec.readout) {
      readout.textContent = spec.readout(at) || " ";
      return;
    }
    readout.textContent =
      `${spec.x} ${number(data[0][at])}: ` +
      spec.series
        .map((each, k) => `${each.name} ${number(data[k + 1][at], each.digits ?? 2, each.unit)}`)
        .join(", ");
  };

  function markOf(self) {
    const mark = spec.mark?.();
    if (mark) drawMark(self, mark.x, mark.text, { ink: ink("good"), paper: ink("paper") });
  }

  function build() {
    plot?.destroy();
    const axis = {
      stroke: ink("quiet"),
      grid: { stroke: ink("line"), width: 1 },
      ticks: { stroke: ink("line") },
      font: "12px system-ui",
    };
    const right = spec.series.some((each) => each.axis === "right");
    plot = new uPlot(
      {
        width: Math.max(place.clientWidth, 200),
        height: spec.height ?? 240,
        legend: { show: false },
        cursor: { drag: { x: true, y: false } },
        scales: {
          x: { time: false },
          y: spec.limits?.y ? { range: spec.limits.y } : {},
          right: { range: spec.limits?.right ?? null },
        },
        axes: [
          spec.x === "Iteration" ? { ...axis, incrs: WHOLE_STEPS } : axis,
          { ...axis, size: 56, label: spec.axes?.left, labelSize: 18, labelFont: axis.font },
          ...(right
            ? [
                {
                  ...axis,
                  scale: "right",
                  side: 1,
                  grid: { show: false },
                  size: 48,
                  label: spec.axes?.right,
                  labelSize: 18,
                  labelFont: axis.font,
                },
              ]
            : []),
        ],
        series: [
          {},
          ...spec.series.map((each, k) => ({
            label: each.name,
            scale: each.axis === "right" ? "right" : "y",
            show: shown[k],
            spanGaps: true,
            stroke: ink(each.color),
            width: each.dots ? 0 : 2,
            dash: each.dash,
            points: {
              show: each.dots ? true : (self) => self.data[0].length < 2,
              size: each.dots ? 5 : 8,
              fill: ink(each.faint ? each.color.replace("c", "dots") : each.color),
              stroke: ink(each.faint ? each.color.replace("c", "dots") : each.color),
            },
          })),
        ],
        hooks: { setCursor: [(self) => read(self.cursor.idx)], draw: [markOf] },
      },
      data,
      place,
    );
  }

  const resize = new ResizeObserver(() => {
    if (plot && place.clientWidth)
      plot.setSize({ width: place.clientWidth, height: spec.height ?? 240 });
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
    update(columns) {
      data = columns;
      if (plot) plot.setData(data);
      else if (place.isConnected) build();
      read(null);
    },
  };
}
