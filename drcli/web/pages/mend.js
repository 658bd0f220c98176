// Where in the page something can be mended that a sentence names.

/** @type {[RegExp, string, string][]} */
const STEPS = [
  [/hyperparameters\.json/, "hyperparameters", "Open the hyperparameters"],
  [/model_metadata\.json/, "actions", "Open the actions"],
];

/**
 * A link to the place that a sentence is about: a line of the reward function, a file, a setting.
 * @param {string} text
 * @returns {{text: string, href: string} | null} null if it cannot be mended in the page
 */
export function mendLink(text) {
  const line = /reward_function\.py(?::|"?, line |:? line )(\d+)/.exec(text)?.[1];
  if (line) return { text: `Open line ${line}`, href: `#/new?step=reward&line=${line}` };
  if (/reward_function\.py|reward function/i.test(text))
    return { text: "Open the reward function", href: "#/new?step=reward" };
  for (const [pattern, step, name] of STEPS)
    if (pattern.test(text)) return { text: name, href: `#/new?step=${step}` };
  const setting = /\bDR_[A-Z0-9_]+/.exec(text)?.[0];
  if (setting) return { text: `Open ${setting}`, href: `#/settings?name=${setting}` };
  return /\b(run|system|worker-\d+)\.env\b/.test(text)
    ? { text: "Open the settings", href: "#/settings" }
    : null;
}
