// Colours of colors.css, for what is drawn on a canvas.

/** The colour of a token, such as "c1", in the present theme. */
export const ink = (token) =>
  getComputedStyle(document.documentElement).getPropertyValue(`--${token}`).trim();
