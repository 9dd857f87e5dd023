// The simulation, beside the page's own thread: MuJoCo steps, the policy decides.

import loadMujoco from "./built/mujoco/mujoco.js";
import * as ort from "./built/onnxruntime/ort.wasm.bundle.min.mjs";
import { makeInputs } from "./inputs.js";
import { look, moving } from "./look.js";
import { Physics } from "./physics.js";
import { TICK, Traffic } from "./traffic.js";

const SLICE = 40; // ms of simulation between reports at most
const LAG = 0.1; // s behind real time that it catches up with
ort.env.wasm.numThreads = 1; // more need headers that a plain web server does not send

let [mujoco, session, about, traffic, drawn] = [];
let [run, speed, paused, manual] = [0, 1, false, false];

async function prepare() {
  const policy = new URL("./built/policy.onnx", import.meta.url).href;
  const file = new URL("./built/demo.json", import.meta.url);
  [mujoco, session, about] = await Promise.all([
    loadMujoco(), ort.InferenceSession.create(policy), fetch(file).then((x) => x.json()),
  ]);
}

async function decide(inputs) {
  const feeds = {};
  for (const [name, { type, shape, array }] of Object.entries(inputs)) {
    feeds[name] = new ort.Tensor(type, array, shape);
  }
  const { action } = await session.run(feeds);
  return Array.from(action.data);
}

async function load(name, car, people) {
  const own = ++run;
  const lot = about.lots[name].cars[car];
  const xml = await fetch(new URL(`./built/${name}-${car}.xml`, import.meta.url)).then((x) => x.text());
  if (own !== run) return;
  const old = traffic;
  const physics = new Physics(mujoco, xml, lot);
  traffic = new Traffic(physics, about, lot, people, makeInputs(about, lot), decide);
  traffic.manual = manual;
  setTimeout(() => old?.physics.delete(), 1000); // once its last tick is over
  drawn = moving(physics);
  postMessage({ look: look(physics), lot, name, car });
  await loop(own, traffic);
}

async function loop(own, traffic) {
  let [wall, due] = [performance.now(), 0];
  while (own === run) {
    const now = performance.now();
    due += paused ? 0 : (speed * (now - wall)) / 1000;
    wall = now;
    while (due >= TICK && own === run && performance.now() - now < SLICE) {
      await traffic.tick();
      due -= TICK;
    }
    due = Math.min(due, LAG); // a slow machine simulates slower than real time
    if (own === run) report(traffic);
    await new Promise((resolve) => setTimeout(resolve, 4));
  }
}

function report({ physics, cars, people, time, counts, seconds, cost, events, first, manual }) {
  const places = physics.places(drawn);
  const state = cars.map(({ pose, speed, steering, goal, end, begun, bumped }) =>
    ({ pose, speed, steering, goal, begun, bumped, outcome: end?.outcome ?? null }));
  postMessage({ places, cars: state, people: people.all.map(({ xy }) => xy), time, counts, seconds, cost, events, first, manual }, [places.buffer]);
  events.length = 0;
}

onmessage = ({ data }) => {
  if ("speed" in data) speed = data.speed;
  if ("paused" in data) paused = data.paused;
  if ("manual" in data) manual = data.manual;
  if ("load" in data) load(data.load, data.car, data.people).catch(fail); // once the page knows the lots
  else if (traffic) {
    const [car] = traffic.cars;
    if ("manual" in data) Object.assign(traffic, { manual }), (car.begun = traffic.time);
    if ("action" in data && manual) car.action = data.action;
    if (data.again) traffic.restart();
  }
};

const fail = (error) => postMessage({ error: String(error?.message ?? error) });
prepare().then(() => postMessage({
  lots: Object.entries(about.lots).map(([name, { title, cars }]) => [name, title, Object.keys(cars)]), people: about.people,
}), fail);
