// Processor, memory, graphics processor and disk of the machine of the console.

import { bytes, failure, fill, h, number } from "/dom.js";
import { follow } from "/socket.js";

function meter(name) {
  const bar = h("span", { class: "live-meter-fill" }),
    text = h("dd", {}, "–");
  const element = h(
    "div",
    {},
    h("dt", {}, name),
    text,
    h("span", { class: "live-meter", "aria-hidden": "true" }, bar),
  );
  return {
    element,
    set(value, share) {
      if (text.textContent !== value) text.textContent = value;
      bar.style.setProperty("transform", `scaleX(${Math.min(1, Math.max(0, share ?? 0))})`);
      bar.classList.toggle("full", share > 0.92);
    },
  };
}

export function machinePanel(signal) {
  const processor = meter("Processor"),
    memory = meter("Memory"),
    disk = meter("Disk of the folder"),
    gpus = [];
  const list = h("dl", { class: "tiles" }, processor.element, memory.element, disk.element);
  const name = h("p", { class: "quiet" }, " "),
    problem = h("div", {});
  follow(
    "machine",
    (now) => {
      if (now.error) {
        fill(problem, failure(now.error));
        return;
      }
      fill(problem);
      const text = `${now.name || "Processor"}, ${number(now.cores)} cores${now.load === null ? "" : `, load ${number(now.load, 1)}`}`;
      if (name.textContent !== text) name.textContent = text;
      processor.set(number(now.processor_percent, 0, "%"), now.processor_percent / 100);
      memory.set(
        `${bytes(now.memory_used_bytes)} of ${bytes(now.memory_bytes)}`,
        now.memory_used_bytes / now.memory_bytes,
      );
      disk.set(
        `${bytes(now.disk_used_bytes)} of ${bytes(now.disk_bytes)}`,
        now.disk_used_bytes / now.disk_bytes,
      );
      now.gpus.forEach((gpu, k) => {
        if (!gpus[k]) {
          gpus[k] = meter(gpu.name || `GPU ${k}`);
          list.append(gpus[k].element);
        }
        gpus[k].set(
          `${number(gpu.percent, 0, "%")}, ${bytes(gpu.memory_used_bytes)} of ${bytes(gpu.memory_bytes)}`,
          gpu.percent === null ? 0 : gpu.percent / 100,
        );
      });
    },
    signal,
  );
  return h(
    "section",
    { "aria-labelledby": "live-machine" },
    h("h2", { id: "live-machine" }, "This machine"),
    name,
    list,
    problem,
  );
}
