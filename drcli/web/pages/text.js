// Numbers with their units, times and sizes in words.

const formats = new Map(); // to make one takes far longer than to use it

/** A number with digits behind the point; a dash for nothing. */
export function number(value, digits = 0, unit = "") {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!formats.has(digits))
    formats.set(
      digits,
      new Intl.NumberFormat("en", {
        minimumFractionDigits: digits,
        maximumFractionDigits: digits,
        signDisplay: "negative", // no minus before a zero
      }),
    );
  const text = formats.get(digits).format(value);
  return unit ? `${text} ${unit}` : text;
}

/** A number with about four digits, however large it is. */
export function short(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  return size >= 1e6 || (value && size < 1e-3)
    ? value.toExponential(2)
    : String(Number(value.toPrecision(size >= 1000 ? 6 : 4)));
}

/** Seconds as "1 h 02 min", "3 min 20 s" or "12 s". */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const whole = Math.round(seconds),
    hours = Math.floor(whole / 3600),
    minutes = Math.floor(whole / 60) % 60;
  if (hours) return `${hours} h ${String(minutes).padStart(2, "0")} min`;
  return minutes ? `${minutes} min ${String(whole % 60).padStart(2, "0")} s` : `${whole} s`;
}

/** A lap time as the console writes it: MM:SS.mmm. */
export function lapTime(seconds) {
  if (seconds === null || seconds === undefined) return "–";
  const ms = Math.round(seconds * 1000);
  const pad = (value, width) => String(value).padStart(width, "0");
  return `${pad(Math.floor(ms / 60000), 2)}:${pad(Math.floor(ms / 1000) % 60, 2)}.${pad(ms % 1000, 3)}`;
}

/** Resets after another text: ", 1 reset", ", 2 resets", or nothing. */
export const andResets = (count) => (count ? `, ${count} reset${count === 1 ? "" : "s"}` : "");

/** Bytes as MB or GB. */
export function bytes(value) {
  if (value === null || value === undefined) return "–";
  if (value >= 1e9) return number(value / 1e9, 1, "GB");
  if (value >= 1e6) return number(value / 1e6, 1, "MB");
  return number(value / 1e3, 0, "kB");
}

/** A date and time of this machine, from Unix seconds. */
export function moment(unix) {
  return unix
    ? new Date(unix * 1000).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "short" })
    : "–";
}

/** The mean of numbers; null without any. */
export const mean = (values) =>
  values?.length ? values.reduce((sum, value) => sum + value, 0) / values.length : null;

/** The first letter in upper case. */
export const capital = (text) => text.replace(/^./, (letter) => letter.toUpperCase());
