// A picture of a worker that is replaced by each newer one; its size never changes.

import { h, number } from "/dom.js";

/** `show` takes what a picture topic gives; `wait` says why there is none. */
export function livePicture(name, label, [width, height]) {
  const canvas = h("canvas", {
    role: "img",
    "aria-label": label,
    width: String(width),
    height: String(height),
  });
  const note = h("figcaption", {}, name);
  const over = h("p", { class: "live-over" }, "Waiting for the first picture.");
  const element = h(
    "figure",
    { class: "live-picture" },
    h("div", { class: "live-frame" }, canvas, over),
    note,
  );
  element.querySelector(".live-frame").style.setProperty("aspect-ratio", `${width} / ${height}`);
  const pen = canvas.getContext("2d");
  let drawing = false,
    newest = null;

  async function draw() {
    drawing = true;
    while (newest) {
      const { facts, blob } = newest;
      newest = null;
      try {
        const picture = await createImageBitmap(blob);
        if (canvas.width !== picture.width || canvas.height !== picture.height) {
          canvas.width = picture.width;
          canvas.height = picture.height;
        }
        pen.drawImage(picture, 0, 0);
        picture.close();
        over.hidden = true;
        const age = Date.now() - 1000 * facts.step_s;
        canvas.dataset.ageMs = age.toFixed(1);
        canvas.dataset.stepS = facts.step_s;
        note.textContent = `${name}${facts.car === null || facts.car === undefined ? "" : `, car ${facts.car + 1}`}, ${age < 10000 ? number(age, 0, "ms") : "more than 10 s"} after its step`;
      } catch {
        /* a damaged picture; the next one comes soon */
      }
    }
    drawing = false;
  }

  return {
    element,
    show(value) {
      newest = value;
      if (!drawing) draw();
    },
    wait(sentence) {
      over.textContent = sentence;
      over.hidden = false;
    },
  };
}
