// Curves along one or two laps, with a line at the step that is shown; a click goes to its step.

import { lastAt } from "/lap_player.js";
import { Plot } from "/plot.js";
import { number } from "/text.js";
import { html, useMemo } from "/ui.js";

const AXES = { time: { x: "seconds" }, progress: { x: "progress in %" } };

/** The rows at which x is greater than ever before: a plot needs an x that rises strictly. */
function risingRows(x) {
  let last = -Infinity;
  return x.flatMap((value, k) => (value > last ? [((last = value), k)] : []));
}

/**
 * @param {{title: string, unit?: string, digits?: number, lines: {name: string, of: (data: any) => number[], dash?: number[]}[],
 *   laps: any[], names: string[], colors: string[], over: string, x: number[][], at: number, rows: number[],
 *   seek: (x: number) => void, version?: string}} props
 *   x is what each lap is aligned by, `version` changes with what the lines show.
 */
export function Curve({ title, unit = "", digits = 2, lines, version = "", ...laid }) {
  const { laps, names, colors, over, x, at, rows, seek } = laid;
  const two = laps.length > 1;
  const values = useMemo(
    () => laps.map((data) => lines.map((line) => line.of(data))),
    [laps, version],
  );
  const data = useMemo(() => {
    const tables = laps.map((_, k) => {
      const rising = risingRows(x[k]);
      return [x[k], ...values[k]].map((column) => rising.map((row) => column[row]));
    });
    return two ? uPlot.join(tables) : tables[0];
  }, [values, over]);
  const series = laps.flatMap((_, k) =>
    lines.map(({ name, dash }) => ({
      name: `${names[k]} ${name}`,
      group: two ? names[k] : name,
      color: colors[k],
      dash,
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
function timeAt({ lap, progress }, share) {
  const row = lastAt(progress, share);
  const next = Math.min(row + 1, progress.length - 1);
  const gain = progress[next] - progress[row];
  const part = gain > 0 ? Math.min(Math.max((share - progress[row]) / gain, 0), 1) : 0;
  return lap.time_s[row] + part * (lap.time_s[next] - lap.time_s[row]);
}

/** How many seconds the second lap is ahead of the first at each progress that both reach. @param {any} props */
export function Gain({ laps, colors, over, rows, seek }) {
  const [first, second] = laps;
  const data = useMemo(() => {
    const most = Math.min(first.progress.at(-1), second.progress.at(-1));
    const shares = risingRows(first.progress)
      .map((row) => first.progress[row])
      .filter((share) => share >= second.progress[0] && share <= most);
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
