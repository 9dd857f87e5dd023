// The page: ties simulation, view and controls together.

import { Controls } from "./controls.js";
import { distance, local } from "./geometry.js";
import { VIEWS, View } from "./view.js";

const SLOW = 20; // frames/s, under which the view draws less
const PATIENCE = 3; // half-seconds of that
const HANDS = 20; // ms between looks at keys

const get = (id) => document.getElementById(id);
const options = new URLSearchParams(location.search);
const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
const view = new View(get("canvas"));
// What the page knows, for its test too.
const demo = (globalThis.demo = { worker, view, report: null, look: null, events: [], fps: 0, first: null });
let [manual, shown, toastEnds, met] = [false, 0, 0, false]; // met: whether the visitor has driven

function setManual(on) {
  if (on && !met) [met, get("begin").hidden] = [true, true], again(); // at its start
  manual = on;
  get("driver").textContent = on ? "Autopilot" : "Drive";
  worker.postMessage({ manual });
  if (on && view.kind === "overview") setView("follow");
}

function setView(kind) {
  get("camera").value = kind;
  view.look(kind);
}

function nextView() {
  const kinds = Object.keys(VIEWS);
  setView(kinds[(kinds.indexOf(view.kind) + 1) % kinds.length]);
}

const again = () => worker.postMessage({ again: true });
const full = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
const controls = new Controls(
  { drive: () => demo.report && !manual && setManual(true), KeyC: nextView, KeyR: again, KeyP: () => setManual(!manual), KeyF: full },
  document.querySelectorAll("[data-hold]"),
);
for (const [kind, title] of Object.entries(VIEWS)) get("camera").add(new Option(title, kind));
get("camera").onchange = ({ target }) => setView(target.value);
get("again").onclick = again;
get("full").onclick = full;
get("full").hidden = !document.fullscreenEnabled;
get("driver").onclick = () => setManual(!manual);
if (self !== top) get("begin").lastElementChild.remove(); // in a frame keys come after a click
get("begin").onclick = () => setManual(true);
for (const list of ["lot", "car", "people"]) get(list).onchange = load;
// Keys drive, whatever was clicked before.
document.addEventListener("click", ({ target }) => target.matches("button") && target.blur());
document.addEventListener("change", ({ target }) => target.blur());
document.addEventListener("visibilitychange", () => {
  worker.postMessage({ paused: document.hidden });
  startMeasuring();
});

function load() {
  const [name, car] = [get("lot").value, get("car").value];
  get("status").textContent = "Loading …";
  const people = Number(get("people").value);
  worker.postMessage({ speed: Number(options.get("speed") ?? 1), manual, load: name, car, people });
}

// Fills a list of choices, the one of the page's address chosen.
function choose(list, entries) {
  for (const [name, title] of entries) get(list).add(new Option(title, name));
  if (entries.some(([name]) => name === options.get(list))) get(list).value = options.get(list);
}

function toast(text) {
  get("toast").textContent = text;
  get("toast").hidden = false;
  toastEnds = performance.now() + 4000;
}

const average = (sum, count) => `${(sum / count).toFixed(0)} s`;

function tell({ kind, car, seconds }) {
  if (car !== 0 || !manual) return;
  const { counts, seconds: sums } = demo.report;
  const policy = counts.parked ? ` The policy needs ${average(sums.parked, counts.parked)} on average.` : "";
  if (kind === "parked") toast(`Parked in ${seconds.toFixed(0)} s.${policy} Next: the bay under the yellow pin`);
  if (kind === "person") toast("You touched a person");
  if (kind === "bumped") toast("Bump! ↓ reverses");
}

// A hint for a stuck visitor; an empty text if there is none.
function hintFor({ pose, speed, goal, outcome }) {
  if (outcome) return "";
  const [bay, size] = [demo.lot.bay_pose[goal], demo.lot.bay_size[goal]];
  const [u, v] = local(bay, pose);
  if (Math.hypot(u, v) < size[0] / 3) {
    const turned = Math.abs(Math.asin(Math.sin(pose[2] - bay[2])));
    return turned < 0.087 ? "Stop with the whole car inside the lines" : `Straighten: ${(57.3 * turned).toFixed(0)}° off, at most 5°`;
  }
  return u < -2 && u > -12 && Math.abs(speed) < 0.5 ? "The bay is behind: ↓ reverses" : "";
}

worker.onmessage = ({ data }) => {
  if (data.error) return void (get("status").textContent = `The demo cannot run: ${data.error}`);
  if (data.lots) {
    choose("lot", data.lots);
    choose("car", data.lots[0][2].map((car) => [car, car[0].toUpperCase() + car.slice(1)]));
    choose("people", [["0", "No people"], [String(data.people), `${data.people} people`]]);
    return load();
  }
  if (data.look) {
    Object.assign(demo, { look: data.look, lot: data.lot, name: data.name, car: data.car, report: null, first: null, events: [] });
    view.show(data.look, data.lot);
    get("begin").hidden = met;
    return startMeasuring();
  }
  demo.report = data;
  demo.first ??= data.first;
  demo.events.push(...data.events);
  data.events.forEach(tell);
};
worker.onerror = (event) => (get("status").textContent = `The demo cannot run: ${event.message ?? "no module workers"}`);

const NOTHING = { time: 0, cost: { steps: 0, physics: 0, decisions: 0, policy: 0 } };
let last = performance.now();
let counted, since, slow, before;

function startMeasuring() {
  [counted, since, slow, before] = [0, performance.now(), 0, demo.report ?? NOTHING];
}

// The visitor's hands, however slowly the view is drawn.
setInterval(() => {
  if (!demo.report) return;
  const { action, active } = controls.read(demo.report.cars[0].speed);
  if (active && !manual) setManual(true);
  if (manual) worker.postMessage({ action });
}, HANDS);

function frame(now) {
  requestAnimationFrame(frame);
  const { report } = demo;
  if (!report) return;
  if (report !== shown) view.move(report);
  shown = report;
  view.draw((now - last) / 1000);
  last = now;
  counted += 1;
  get("toast").hidden ||= now > toastEnds;
  if (now - since > 500) measure(now, report);
}

// Twice a second: numbers for the visitor.
function measure(now, { time, counts, seconds: sums, cost, cars }) {
  const seconds = (now - since) / 1000;
  const gone = (name) => cost[name] - before.cost[name];
  const spent = (ms, count) => gone(ms) / Math.max(1, gone(count));
  demo.fps = counted / seconds;
  demo.rate = (time - before.time) / seconds;
  slow = demo.fps < SLOW ? slow + 1 : 0;
  if (slow === PATIENCE) {
    view.simplify();
    slow = 0;
  }
  const { visitor, bumps, parked, crashed, late } = counts;
  const score = (count, sum) => `${count} parked${count ? ` in ${average(sum, count)} each` : ""}`;
  const mine = visitor || bumps || manual ? `You: ${score(visitor, sums.visitor)}, ${bumps} bumps · ` : "";
  get("status").textContent = `${mine}Policy: ${score(parked, sums.parked)}, ${crashed} crashed, ${late} timed out`;
  const { pose, speed, goal, begun } = cars[0];
  const far = distance(pose, demo.lot.bay_pose[goal]);
  get("speed").textContent = `${Math.abs(3.6 * speed).toFixed(0)} km/h · bay ${far.toFixed(0)} m · ${(time - begun).toFixed(0)} s`;
  get("hint").textContent = manual ? hintFor(cars[0]) : "";
  get("hint").hidden = !get("hint").textContent;
  get("numbers").textContent = [
    `${demo.fps.toFixed(0)} frames/s`, `${demo.rate.toFixed(1)} × real time`,
    `step ${spent("physics", "steps").toFixed(2)} ms`, `decision ${spent("policy", "decisions").toFixed(1)} ms`,
  ].join(" · ");
  [counted, since, before] = [0, now, { time, cost }];
}

new ResizeObserver(() => view.resize(innerWidth, innerHeight)).observe(document.body);
startMeasuring();
requestAnimationFrame(frame);
