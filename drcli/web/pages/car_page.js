// The physical car: its camera, its models, and a model of the bucket that is sent to it.

import { post } from "/api.js";
import { Field } from "/fields.js";
import { pageSeen } from "/live_picture.js";
import { runTask } from "/model_tasks.js";
import { notify } from "/notices.js";
import { Act, useAction, useGet, useTopic } from "/store.js";
import { Button, Empty, Failure, Form, Tiles, html, useState } from "/ui.js";

export const title = "Car";

export function Page() {
  const { value: car, error, reload } = useGet("/api/car");
  if (error)
    return html`<h1>Car</h1><${Failure} error=${error} /><${Button} onClick=${reload}>Look again<//>`;
  if (!car) return html`<h1>Car</h1><p class="quiet">Asking the car …</p>`;
  return html`
    <h1>Car ${car.car}</h1>
    ${car.login ? html`<${Login} car=${car} reload=${reload} />` : html`<${Own} car=${car} reload=${reload} />`}`;
}

function Login({ car, reload }) {
  const [password, setPassword] = useState("");
  const [login, busy] = useAction(async () => {
    const { fingerprint } = await post("/api/car/login", { password });
    if (fingerprint)
      notify(
        `The certificate of the car is accepted; later the car must show the same one. SHA-256: ${fingerprint}`,
      );
    reload();
  });
  return html`
    <p>${car.login}</p>
    <${Form} class="car-login" onSubmit=${login}>
      <${Field} label="Password of the car" type="password" value=${password} set=${setPassword}
        help="That of its own web page; the first one is on a sticker at the bottom of the car. It is not kept, only the login." />
      <p class="actions"><button type="submit" class="main" disabled=${busy || !password}>Log in</button></p>
    <//>`;
}

function Own({ car, reload }) {
  const [begun, setBegun] = useState(0);
  const [failed, setFailed] = useState(false);
  const again = () => {
    setFailed(false);
    setBegun(begun + 1);
    reload();
  };
  return html`
    <p class="actions"><${Button} onClick=${again}>Look again<//></p>
    <div class="car-view">
      <section aria-labelledby="car-camera">
        <h2 id="car-camera">Camera</h2>
        ${
          failed
            ? html`<${Empty} text="The camera sends no picture. Is it connected? The car may need a minute after its start." />`
            : pageSeen.value &&
              html`<img class="car-camera" src=${`/api/car/camera?${begun}`} alt="What the camera of the car sees now" onError=${() => setFailed(true)} />`
        }
        <${Tiles} values=${Object.entries(car.facts)} />
      </section>
      <section aria-labelledby="car-models">
        <h2 id="car-models">Models</h2>
        <${Send} car=${car} reload=${reload} />
        ${car.models.length ? html`<${Models} models=${car.models} reload=${reload} />` : html`<${Empty} text="There are no models on the car." />`}
      </section>
    </div>`;
}

function Send({ car, reload }) {
  const list = useTopic("models").value?.models.map((each) => each.model.prefix) ?? [];
  const [chosen, setChosen] = useState("");
  const prefix = chosen || list[0];
  const send = async () => {
    const { model, usable, why } = await runTask("/api/car/send", { prefix });
    notify(usable ? `The car has ${model} now.` : `The car cannot load ${model} now: ${why}.`);
    reload();
  };
  if (!list.length) return html`<p class="quiet">The bucket has no model yet.</p>`;
  return html`
    <${Field} label="Model of the bucket" value=${prefix} options=${list} set=${setChosen}
      help="Its best checkpoint is sent. A model of the same name on the car is replaced." />
    <p class="actions"><${Act} class="main" action=${send} text=${`Send to ${car.car}`} /></p>`;
}

function Models({ models, reload }) {
  const [load, busy] = useAction(async (name) => {
    await runTask("/api/car/load", { name });
    notify(`The car has loaded ${name}.`);
    reload();
  });
  return html`<ul class="car-models">${models.map(
    (each) => html`<li key=${each.name}>
      <span><strong>${each.name}</strong> <span class="quiet">${[each.size, each.algorithm, each.action_space, each.sensors.join(", ")].filter(Boolean).join(", ")}${each.usable ? "" : `; ${each.why}`}</span></span>
      <${Button} busy=${busy} disabled=${!each.usable} onClick=${() => load(each.name)} aria-label=${`Load ${each.name}`}>Load<//>
    </li>`,
  )}</ul>`;
}
