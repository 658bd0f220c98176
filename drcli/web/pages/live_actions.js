// What the policy wants: probabilities of discrete actions as bars, or mean and spread.

import { fill, h, number } from "/dom.js";

/** `update` takes the actions and what a scene says about the shown car. */
export function actionBars() {
  const list = h("ul", {
    class: "live-bars",
    tabindex: "0",
    "aria-label": "Probabilities of the actions",
  });
  const note = h("p", { class: "quiet live-value" }, " ");
  const element = h("div", {}, h("h4", {}, "Actions"), list, note);
  let rows = [],
    key = "";

  function build(actions) {
    rows = actions.map(([steering, speed]) => {
      const fillOf = h("span", { class: "live-bar-fill" }),
        share = h("span", { class: "live-bar-share" }, "–");
      const item = h(
        "li",
        {},
        h("span", {}, `${number(steering, 0)}°, ${number(speed, 1)} m/s`),
        h("span", { class: "live-bar-room" }, fillOf),
        share,
      );
      return { item, fillOf, share };
    });
    fill(
      list,
      rows.map((row) => row.item),
    );
  }

  return {
    element,
    update(actions, shown) {
      const now = JSON.stringify(actions);
      if (now !== key) {
        key = now;
        build(actions);
      }
      const probabilities = shown?.probabilities ?? [];
      rows.forEach((row, k) => {
        const value = probabilities[k];
        row.fillOf.style.setProperty("transform", `scaleX(${value ?? 0})`);
        row.share.textContent = value === undefined ? "–" : number(100 * value, 0, "%");
        row.item.classList.toggle("taken", shown?.chosen === k);
      });
      const texts = [];
      if (shown?.mean)
        texts.push(
          `Steering ${number(shown.mean[0], 1)}° (${number(shown.low?.[0], 1)} to ${number(shown.high?.[0], 1)}), speed ${number(shown.mean[1], 2)} m/s (${number(shown.low?.[1], 2)} to ${number(shown.high?.[1], 2)}).`,
        );
      else if (shown && !shown.probabilities && actions.length)
        texts.push("The policy gives no probabilities now.");
      if (shown && shown.value !== null && shown.value !== undefined)
        texts.push(`The critic expects a return of ${number(shown.value, 2)} from here on.`);
      note.textContent = texts.join(" ") || " ";
    },
  };
}
