// Curves along one or two laps, with a line at the step that is shown; a click goes to its step.

import { lastAt, valueAt } from "/lap_player.js";
import { Plot, aligned } from "/plot.js";
import { number } from "/text.js";
import { html, useMemo } from "/ui.js";

const AXES = { time: { x: "seconds" }, progress: { x: "progress in %" } };

/**
 * @param {{title: string, unit?: string, digits?: number, lines: Record<string, string>, values?: any[][][],
 *   laps: any[], names: string[], colors: string[], over: string, x: number[][], at: number, rows: number[],
 *   seek: (x: number) => void}} props
 *   x is what each lap is aligned by; lines are names and columns of the laps; values are those of each lap and line
 *   that is no column.
 */
export function Curve({ title, unit = "", digits = 2, lines, values: given, ...laid }) {
  const { laps, names, colors, over, x, at, rows, seek } = laid;
  const two = laps.length > 1;
  const values = useMemo(
    () => given ?? laps.map(({ lap }) => Object.values(lines).map((column) => lap[column])),
    [laps, given],
  );
  const data = useMemo(
    () => aligned(laps.flatMap((_, k) => values[k].map((y) => ({ x: x[k], y })))),
    [values, over],
  );
  const series = laps.flatMap((_, k) =>
    Object.keys(lines).map((name, n) => ({
      name: `${names[k]} ${name}`,
      group: two ? names[k] : name,
      color: colors[k],
      dash: n ? [4, 3] : undefined,
    })),
  );
  const read = () =>
    laps
      .map((_, k) => `${two ? `${names[k]} ` : ""}${number(values[k][0][rows[k]], digits, unit)}`)
      .join(", ");
  return html`<${Plot} title=${title} x=${over} axes=${AXES[over]} height=${150} series=${series} data=${data}
    at=${at} seek=${seek} read=${read} />`;
}

/** Seconds from the beginning of a lap to a progress. */
const timeAt = ({ lap, progress }, share) => valueAt(progress, lap.time_s, share);

/** How many seconds the second lap is ahead of the first at each progress that both reach. @param {any} props */
export function Gain({ laps, colors, over, rows, seek }) {
  const [first, second] = laps;
  const data = useMemo(() => {
    const most = Math.min(first.progress.at(-1), second.progress.at(-1));
    const shares = [...new Set(first.progress)].filter(
      (share) => share >= second.progress[0] && share <= most,
    );
    return [shares, shares.map((share) => timeAt(first, share) - timeAt(second, share))];
  }, [laps]);
  const starts = laps.map((each) => each.facts.episodes[Number(each.query.episode)]?.start_percent);
  const apart = Math.abs((starts[0] ?? 0) - (starts[1] ?? 0)) % 100;
  const share = first.progress[rows[0]];
  const read = () => {
    const [shares, gained] = data;
    if (!shares.length || share > shares.at(-1))
      return `At ${number(share, 1)} %: one of the laps has ended.`;
    const gain = gained[lastAt(shares, share)];
    const sum = `At ${number(share, 1)} % the second lap is ${number(Math.abs(gain), 2)} s ${gain < 0 ? "behind" : "ahead"}`;
    return `${sum}; at the end of the shorter one ${number(Math.abs(gained.at(-1)), 2)} s ${gained.at(-1) < 0 ? "behind" : "ahead"}.`;
  };
  return html`<${Plot} title="Time that the second lap gains" x="progress" axes=${AXES.progress} height=${150}
    hint=${apart > 2 && apart < 98 ? "The laps began at different places, so the same progress is another place of the track." : ""}
    series=${[{ name: "gained", color: colors[1] }]} data=${data} read=${read} at=${share}
    seek=${(x) => seek(over === "time" ? timeAt(first, x) : x)} />`;
}
