// What the graphs of the report and of the console share. A module; the report has it without `export`.

/** Steps of an axis that counts. */
export const WHOLE_STEPS = [1, 10, 100, 1000, 10000, 100000].flatMap((factor) =>
  [1, 2, 5].map((each) => each * factor),
);

/** Draw a dashed vertical line at x with a word at its top, on a ground of `paper`, on the side where it fits. */
export function drawMark(plot, x, text, { ink, paper }) {
  const { ctx, bbox } = plot,
    ratio = devicePixelRatio || 1,
    at = Math.round(plot.valToPos(x, "x", true));
  if (at < bbox.left - 1 || at > bbox.left + bbox.width + 1) return;
  ctx.save();
  ctx.strokeStyle = ink;
  ctx.lineWidth = 2 * ratio;
  ctx.setLineDash([5 * ratio, 4 * ratio]);
  ctx.beginPath();
  ctx.moveTo(at, bbox.top);
  ctx.lineTo(at, bbox.top + bbox.height);
  ctx.stroke();
  ctx.font = `${12 * ratio}px system-ui, sans-serif`;
  const width = ctx.measureText(text).width,
    onRight = at + width + 12 * ratio < bbox.left + bbox.width;
  const left = onRight ? at + 5 * ratio : at - width - 5 * ratio;
  ctx.fillStyle = paper; // other curves may pass below the word
  ctx.fillRect(left - 2 * ratio, bbox.top, width + 4 * ratio, 17 * ratio);
  ctx.fillStyle = ink;
  ctx.textAlign = "left";
  ctx.textBaseline = "top";
  ctx.fillText(text, left, bbox.top + 3 * ratio);
  ctx.restore();
}
