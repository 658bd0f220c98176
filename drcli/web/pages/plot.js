// Curves by uPlot as a component: sizes are reserved, colours follow the theme, values are read below.

import { WHOLE_STEPS, drawMark } from "/graph_parts.js";
import { theme } from "/store.js";
import { number } from "/text.js";
import { ink } from "/theme_colors.js";
import { html, useEffect, useLayoutEffect, useRef, useSeen, useState } from "/ui.js";

/**
 * @typedef {Object} Series
 * @property {string} name
 * @property {string} color such as "c1"
 * @property {string} [group] the toggle that shows it; its name if left out
 * @property {string} [unit]
 * @property {number} [digits]
 * @property {string} [dots] colour of dots, which are drawn instead of a line
 * @property {"right"} [axis]
 * @property {number[]} [dash]
 * @property {boolean} [hidden] only an edge of a band
 */

const groupOf = (each) => each.group ?? each.name;

/** Axes, scales and series as uPlot takes them. */
function optionsOf({ x, series, axes, limits, isShown, seeks, bands }) {
  const font = "12px system-ui";
  const line = ink("line");
  const axis = {
    stroke: ink("quiet"),
    grid: { stroke: line, width: 1 },
    ticks: { stroke: line },
    font,
  };
  const named = (label) => ({ ...axis, label, labelSize: 18, labelFont: font });
  const right = { ...named(axes.right), scale: "right", side: 1, grid: { show: false }, size: 46 };
  return {
    legend: { show: false },
    cursor: { drag: { x: !seeks, y: false }, points: { show: !seeks } },
    scales: {
      x: {
        time: false,
        range: (_, low, high) => (low === high ? [low - 1, high + 1] : [low, high]),
      },
      y: limits.y ? { range: limits.y } : {},
      right: limits.right ? { range: limits.right } : {},
    },
    axes: [
      x === "Iteration"
        ? { ...axis, incrs: WHOLE_STEPS }
        : { ...named(axes.x), size: seeks ? 32 : 50 },
      { ...named(axes.left), size: 52 },
      ...(series.some((each) => each.axis) ? [right] : []),
    ],
    bands: bands.map(([high, low, color]) => ({ series: [high, low], fill: `${ink(color)}30` })),
    series: [
      {},
      ...series.map((each) => ({
        scale: each.axis ?? "y",
        show: isShown(each),
        spanGaps: true,
        stroke: ink(each.color),
        width: each.dots || each.hidden ? 0 : 2,
        dash: each.dash,
        paths: each.dots ? () => null : undefined,
        points: {
          show: each.dots ? true : (self) => !each.hidden && self.data[0].length < 2,
          size: each.dots ? 4 : 8,
          width: 0,
          fill: ink(each.dots ?? each.color),
          stroke: ink(each.dots ?? each.color),
        },
      })),
    ],
  };
}

/**
 * A plot of series over x, with toggles and a line that reads the values under the pointer.
 * @param {{title: string, hint?: string, x?: string, height?: number, series: Series[], data: any[][],
 *   axes?: {x?: string, left?: string, right?: string}, limits?: {y?: number[], right?: number[]},
 *   mark?: {x: number, text: string} | null, read?: (index: number | null) => string, nothing?: string,
 *   at?: number, seek?: (x: number) => void, bands?: [number, number, string][]}} props
 *   `data` is x and a list for each series; `read` says what is at an index, or last, instead of the values;
 *   a line stands at the x of `at`, and `seek` gets the x of a click; bands lie between two series, counted from 1.
 */
export function Plot(props) {
  const {
    title,
    hint = "",
    x = "Iteration",
    height = 240,
    series,
    data,
    axes = {},
    limits = {},
  } = props;
  const plot = useRef(null);
  const state = useRef({ visible: true, late: false, zoomed: false, stand: () => {} });
  const [hidden, setHidden] = useState([]);
  const [index, setIndex] = useState(null);
  const isShown = (each) =>
    !hidden.includes(groupOf(each)) && !(each.dots && hidden.includes("dots"));
  const newest = useRef(props);
  newest.current = props;

  const draw = () => {
    const { current } = plot;
    if (!current) return;
    if (!state.current.visible) {
      state.current.late = true;
      return;
    }
    state.current.late = false;
    current.setData(newest.current.data, !state.current.zoomed);
    // A part that somebody looks at stays as it is.
    if (state.current.zoomed) current.redraw(false, false);
  };
  const place = useSeen((visible) => {
    state.current.visible = visible;
    if (visible && state.current.late) draw();
  });

  useLayoutEffect(() => {
    const element = place.current;
    const line = Object.assign(document.createElement("div"), { className: "plot-at" });
    state.current.zoomed = false;
    state.current.stand = () => {
      const { at = null } = newest.current;
      line.hidden = at === null;
      line.style.transform = `translateX(${Math.round(self.valToPos(at ?? 0, "x"))}px)`;
    };
    const self = new uPlot(
      {
        ...optionsOf({
          x,
          series,
          axes,
          limits,
          isShown,
          seeks: Boolean(props.seek),
          bands: props.bands ?? [],
        }),
        width: Math.max(element.clientWidth, 200),
        height,
        hooks: {
          setCursor: [(each) => setIndex(each.cursor.left < 0 ? null : each.cursor.idx)],
          setSelect: [(each) => (state.current.zoomed ||= each.select.width > 0)],
          draw: [
            (each) => {
              const { mark } = newest.current;
              state.current.stand();
              if (mark)
                drawMark(each, mark.x, mark.text, { ink: ink("good"), paper: ink("paper") });
            },
          ],
        },
      },
      newest.current.data,
      element,
    );
    self.over.append(line);
    self.over.addEventListener("click", (event) =>
      newest.current.seek?.(self.posToVal(event.offsetX, "x")),
    );
    self.over.addEventListener("dblclick", () => (state.current.zoomed = false));
    plot.current = self;
    const resize = new ResizeObserver(() => {
      if (element.clientWidth) self.setSize({ width: element.clientWidth, height });
    });
    resize.observe(element);
    return () => {
      resize.disconnect();
      self.destroy();
      plot.current = null;
    };
  }, [theme.value, JSON.stringify([series, axes, limits, height])]);
  useEffect(() => {
    const frame = requestAnimationFrame(draw);
    return () => cancelAnimationFrame(frame);
  }, [data, props.mark?.x]);

  useEffect(() => state.current.stand(), [props.at]);

  const text = readout(props, index);
  useEffect(() => {
    const canvas = plot.current?.root.querySelector("canvas");
    canvas?.setAttribute("role", "img");
    canvas?.setAttribute("aria-label", `${title}. ${text}`);
  }, [text, theme.value]);

  const toggle = (name) => {
    const now = hidden.includes(name) ? hidden.filter((each) => each !== name) : [...hidden, name];
    setHidden(now);
    series.forEach((each, k) => {
      const show = !now.includes(groupOf(each)) && !(each.dots && now.includes("dots"));
      plot.current.setSeries(k + 1, { show }, false);
    });
    plot.current.redraw(true, true);
  };
  const groups = new Map(
    series.filter((each) => !each.dots).map((each) => [groupOf(each), each.color]),
  );
  const names = [...groups.keys(), ...(series.some((each) => each.dots) ? ["dots"] : [])];
  return html`
    <figure class="chart">
      <figcaption><strong>${title}</strong> ${hint}</figcaption>
      ${
        names.length > 1 &&
        html`<div class="toggles" role="group" aria-label=${`Curves of ${title}`}>
        ${names.map(
          (name) => html`<button type="button" class="toggle" key=${name}
            aria-pressed=${String(!hidden.includes(name))} onClick=${() => toggle(name)}>
            ${groups.has(name) && html`<span class=${`swatch ink-${groups.get(name)}`}></span>`}
            ${name === "dots" ? "Episodes as dots" : name}
          </button>`,
        )}
      </div>`
      }
      <div class="plot" ref=${place} style=${{ minHeight: `${height}px` }}></div>
      <p class="readout">${text}</p>
    </figure>`;
}

/** @param {any} props */
function readout({ x = "Iteration", series, data, read, nothing = " " }, index) {
  if (read) return read(index) || nothing;
  const at = index ?? data[0].length - 1;
  if (at < 0 || data[0][at] === undefined) return nothing;
  const values = series.map(
    (each, k) => `${each.name} ${number(data[k + 1][at], each.digits ?? 2, each.unit)}`,
  );
  return `${x} ${number(data[0][at])}: ${values.join(", ")}`;
}
