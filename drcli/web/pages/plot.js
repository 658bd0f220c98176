// Curves by uPlot as a component: sizes are reserved, colours follow the theme, values are read below.

import { number, short } from "/text.js";
import { ink, theme } from "/theme_colors.js";
import { html, render, useEffect, useLayoutEffect, useRef, useSeen, useState } from "/ui.js";

/**
 * @typedef {Object} Series
 * @property {string} name
 * @property {string} color such as "c1"
 * @property {string} [group] the toggle that shows it; its name if left out
 * @property {string} [unit]
 * @property {number} [digits] four significant ones if left out
 * @property {number} [dots] size of dots, which are drawn instead of a line
 * @property {"right"} [axis]
 * @property {number[]} [dash]
 * @property {boolean} [hidden] only an edge of a band
 * @property {boolean} [off] not shown until somebody wants it
 */

const FONT = "12px system-ui, sans-serif";
/** Steps of an axis that counts. */
const WHOLE_STEPS = [1, 10, 100, 1000, 10000, 100000].flatMap((factor) =>
  [1, 2, 5].map((each) => each * factor),
);
const NONE = [];
const groupOf = (each) => each.group ?? each.name;
const isMissing = (value) => value === null || value === undefined;

/** Columns as `Plot` takes them, of series that each have their own x and y. @param {{x: any, y: any}[]} series */
export function aligned(series) {
  const points = series.flatMap(({ x, y }, which) =>
    Array.from(x, (at, k) => [at, which, y[k]]).filter((point) => point.every(Number.isFinite)),
  );
  points.sort((a, b) => a[0] - b[0]);
  const columns = [[], ...series.map(() => [])];
  const [xs] = columns;
  for (const [x, which, y] of points) {
    if (xs.at(-1) !== x || columns[which + 1].at(-1) !== null) {
      for (const column of columns) column.push(null);
      xs[xs.length - 1] = x;
    }
    columns[which + 1][xs.length - 1] = y;
  }
  return columns;
}

/** The row next to another one in which a series has a value; undefined without any. */
function nearestRow(column, xs, row) {
  let below = row;
  let above = row;
  while (below >= 0 && isMissing(column[below])) below -= 1;
  while (above < column.length && isMissing(column[above])) above += 1;
  return [below, above]
    .filter((each) => each in column)
    .sort((a, b) => Math.abs(xs[a] - xs[row]) - Math.abs(xs[b] - xs[row]))[0];
}

/** A number beside an axis: of large ones, thousands or millions. */
const tickText = (value) =>
  Math.abs(value) < 1e4
    ? short(value)
    : value.toLocaleString("en", { notation: "compact", maximumSignificantDigits: 6 });

/** Axes, scales and series as uPlot takes them. */
function optionsOf({ x, series, axes, limits, isShown, seeks, bands }) {
  const axis = {
    stroke: ink("quiet"),
    grid: { stroke: ink("line"), width: 1 },
    ticks: { stroke: ink("line") },
    font: FONT,
    values: (_, ticks) => ticks.map(tickText),
  };
  const named = (label) => ({ ...axis, label, labelSize: 18, labelFont: FONT });
  const side = (label) => ({
    ...named(label),
    size: (_, ticks) => 20 + 7 * Math.max(3, ...(ticks ?? []).map((each) => each.length)),
  });
  return {
    legend: { show: false },
    cursor: {
      dataIdx: (self, k, row) => nearestRow(self.data[k], self.data[0], row) ?? row,
      drag: { x: !seeks, y: false },
      points: { show: !seeks },
    },
    scales: {
      x: {
        time: false,
        // Without points both are null, and the axis has no numbers.
        range: (_, low, high) => (low === high && low !== null ? [low - 1, high + 1] : [low, high]),
      },
      y: limits.y ? { range: limits.y } : {},
      right: limits.right ? { range: limits.right } : {},
    },
    axes: [
      x === "Iteration"
        ? { ...axis, incrs: WHOLE_STEPS }
        : { ...named(axes.x), size: seeks ? 32 : 50 },
      side(axes.left),
      ...(series.some((each) => each.axis)
        ? [{ ...side(axes.right), scale: "right", side: 1, grid: { show: false } }]
        : []),
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
          // A line needs two points.
          show: (self, k) =>
            Boolean(each.dots) ||
            (!each.hidden && self.data[k].filter((value) => !isMissing(value)).length < 3),
          size: each.dots ?? 8,
          width: 0,
          fill: ink(each.color),
          stroke: ink(each.color),
        },
      })),
    ],
  };
}

/**
 * A plot of series over x, with toggles and a line that reads the values under the pointer.
 * @param {{title: string, hint?: string, x?: string, xDigits?: number, height?: number, series: Series[], data: any[][],
 *   axes?: {x?: string, left?: string, right?: string}, limits?: {y?: number[], right?: number[]}, near?: number,
 *   marks?: {x: number, label: string}[], read?: (index: number | null) => string, nothing?: string,
 *   at?: number, seek?: (x: number) => void, bands?: [number, number, string][]}} props
 *   `data` is x and a list for each series; values are read that are at most `near` from x, unless `read` says what is
 *   at an index, or last; a line stands at the x of `at`, and `seek` gets the x of a click; bands lie between two
 *   series, counted from 1.
 */
export function Plot(props) {
  const { title, hint = "", x = "Iteration", height = 240, series, data, seek } = props;
  const { axes = {}, limits = {}, marks = NONE, bands = NONE } = props;
  const plot = useRef(null);
  const over = useRef(null);
  const [hidden, setHidden] = useState(() => series.filter((each) => each.off).map(groupOf));
  const [index, setIndex] = useState(null);
  const [byKey, setByKey] = useState(false);
  const [zoomed, setZoomed] = useState(false);
  const [visible, setVisible] = useState(true);
  const place = useSeen(setVisible);
  const isShown = (each) => !hidden.includes(groupOf(each));
  const newest = useRef(props);
  newest.current = props;
  /** Lines at marks, and where a player is. */
  const drawLines = () => {
    const { marks = NONE, at = null } = newest.current;
    const lines = at === null ? marks : [...marks, { x: at, label: "" }];
    const drawn = lines.map(({ x, label }) => {
      const left = Math.round(plot.current.valToPos(x, "x"));
      const side = left > over.current.clientWidth / 2 ? "left" : "";
      return html`<div class=${label ? `plot-mark ${side}` : "plot-at"} style=${{ left: `${left}px` }}><span>${label}</span></div>`;
    });
    render(drawn, over.current);
  };

  useLayoutEffect(() => {
    const element = place.current;
    over.current = Object.assign(document.createElement("div"), { className: "plot-over" });
    setZoomed(false);
    const self = new uPlot(
      {
        ...optionsOf({ x, series, axes, limits, isShown, seeks: Boolean(seek), bands }),
        width: Math.max(element.clientWidth, 200),
        height,
        hooks: {
          setCursor: [(each) => setIndex(each.cursor.left < 0 ? null : each.cursor.idx)],
          setSelect: [(each) => each.select.width > 0 && setZoomed(true)],
          draw: [drawLines],
        },
      },
      data,
      element,
    );
    self.over.append(over.current);
    self.over.addEventListener("dblclick", () => setZoomed(false));
    plot.current = self;
    const resize = new ResizeObserver(() => {
      if (element.clientWidth) self.setSize({ width: element.clientWidth, height });
    });
    resize.observe(element);
    return () => {
      resize.disconnect();
      self.destroy();
    };
  }, [theme.value, JSON.stringify([series, axes, limits, height])]);
  useEffect(() => {
    if (!visible) return undefined;
    const frame = requestAnimationFrame(() => {
      plot.current.setData(data, !zoomed);
      // A part that somebody looks at stays as it is.
      if (zoomed) plot.current.redraw(false, false);
    });
    return () => cancelAnimationFrame(frame);
  }, [data, visible, JSON.stringify(marks)]);
  useEffect(drawLines, [props.at]);
  useEffect(() => {
    series.forEach((each, k) => {
      const show = isShown(each);
      if (plot.current.series[k + 1].show !== show) plot.current.setSeries(k + 1, { show });
    });
  }, [hidden]);

  const text = readout(props, index, isShown);
  useEffect(() => {
    const canvas = plot.current.root.querySelector("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${title}. ${text}`);
  }, [text, theme.value]);

  const showAll = () => {
    setZoomed(false);
    plot.current.setData(data);
    place.current.focus();
  };
  /** Read the next value of the first line. */
  const press = (event) => {
    const by = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!by || !data[0].length) return;
    event.preventDefault();
    const read = series.findIndex((each) => !each.dots && isShown(each)) + 1;
    const isEmpty = (row) => row in data[0] && isMissing(data[read][row]);
    let row = (index ?? -1) + by;
    while (isEmpty(row)) row += by;
    if (!(row in data[0])) return;
    plot.current.setCursor({ left: plot.current.valToPos(data[0][row], "x"), top: 10 });
    setIndex(row);
    setByKey(true);
  };
  const click = ({ target, offsetX }) =>
    target === plot.current.over && seek(plot.current.posToVal(offsetX, "x"));
  const keys = !seek && {
    tabindex: 0,
    role: "group",
    "aria-label": `${title}. The left and right arrow keys read its values.`,
    onKeyDown: press,
  };
  const names = new Map(series.map((each) => [groupOf(each), each]));
  return html`
    <figure class="chart">
      <figcaption><strong>${title}</strong> ${hint}</figcaption>
      ${
        (names.size > 1 || zoomed) &&
        html`<div class="toggles" role="group" aria-label=${`Curves of ${title}`}>
        ${[...names].map(
          ([
            name,
            { color, dots },
          ]) => html`<button type="button" class="toggle" key=${name} aria-pressed=${String(!hidden.includes(name))}
            onClick=${() => setHidden(hidden.includes(name) ? hidden.filter((each) => each !== name) : [...hidden, name])}>
            <span class=${`swatch ink-${color}${dots ? " dots" : ""}`}></span>${name}
          </button>`,
        )}
        ${zoomed && html`<button type="button" class="toggle" onClick=${showAll}>Show all</button>`}
      </div>`
      }
      <div class="plot" ref=${place} style=${{ minHeight: `${height}px` }} onClick=${seek && click} ...${keys}></div>
      <p class="readout" aria-live=${byKey ? "polite" : "off"}>${text}</p>
    </figure>`;
}

/** @param {any} props */
function readout(props, index, isShown) {
  const { x = "Iteration", xDigits = 0, series, data, near = 0.5, read, nothing = " " } = props;
  if (read) return read(index) || nothing;
  const at = index ?? data[0].length - 1;
  if (!(at in data[0])) return nothing;
  const values = series.filter(isShown).flatMap((each) => {
    const column = data[series.indexOf(each) + 1];
    const row = nearestRow(column, data[0], at);
    if (row === undefined || Math.abs(data[0][row] - data[0][at]) > near) return [];
    const value = each.digits === undefined ? short(column[row]) : number(column[row], each.digits);
    return [`${each.name} ${value}${each.unit ? ` ${each.unit}` : ""}`];
  });
  return `${x} ${number(data[0][at], xDigits)}: ${values.join(", ")}`;
}
