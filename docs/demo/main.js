// The page: ties simulation, view and controls together.

import { Controls } from "./controls.js";
import { CAMERAS, View } from "./view.js";

const SLOW = 20; // frames/s, under which the view draws less
const PATIENCE = 3; // half-seconds of that

const get = (id) => document.getElementById(id);
const options = new URLSearchParams(location.search);
const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
const view = new View(get("canvas"));
// What the page knows, for its test too.
const demo = (globalThis.demo = { worker, view, report: null, look: null, events: [], fps: 0, first: null });
let [manual, shown, toastEnds] = [false, 0, 0];

function setManual(on) {
  manual = on;
  get("driver").textContent = on ? "Policy takes over" : "You take over";
  worker.postMessage({ manual });
  if (on && view.kind === "overview") setCamera("follow");
}

function setCamera(kind) {
  get("camera").textContent = `Camera: ${kind}`;
  view.look(kind);
}

const nextCamera = () => setCamera(CAMERAS[(CAMERAS.indexOf(view.kind) + 1) % CAMERAS.length]);
const again = () => worker.postMessage({ again: true });
const controls = new Controls(
  { KeyC: nextCamera, KeyR: again, KeyP: () => setManual(!manual) },
  document.querySelectorAll("[data-hold]"),
);
get("camera").onclick = nextCamera;
get("again").onclick = again;
get("driver").onclick = () => setManual(!manual);
get("lot").onchange = ({ target }) => load(target.value);
document.addEventListener("click", ({ target }) => target.matches("button") && target.blur()); // keys drive
document.addEventListener("visibilitychange", () => {
  worker.postMessage({ paused: document.hidden });
  startMeasuring();
});

function load(name) {
  get("lot").value = name;
  get("lot").blur();
  get("status").textContent = "Loading …";
  worker.postMessage({ speed: Number(options.get("speed") ?? 1), manual, load: name });
}

function toast(text) {
  get("toast").textContent = text;
  get("toast").hidden = false;
  toastEnds = performance.now() + 2500;
}

function tell({ kind, car, seconds }) {
  if (car === 0 && manual && kind === "parked") toast(`Parked in ${seconds.toFixed(0)} s`);
  if (car === 0 && kind === "bumped") toast("Bump!");
}

worker.onmessage = ({ data }) => {
  if (data.error) return void (get("status").textContent = `The demo cannot run: ${data.error}`);
  if (data.lots) {
    for (const [name, title] of data.lots) get("lot").add(new Option(title, name));
    const wanted = options.get("lot");
    return load(data.lots.some(([name]) => name === wanted) ? wanted : data.lots[0][0]);
  }
  if (data.look) {
    Object.assign(demo, { look: data.look, lot: data.lot, name: data.name, report: null, first: null, events: [] });
    view.show(data.look, data.lot);
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

function frame(now) {
  requestAnimationFrame(frame);
  const { report } = demo;
  if (!report) return;
  const { action, active } = controls.read(report.cars[0].speed);
  if (active && !manual) setManual(true);
  if (manual) worker.postMessage({ action });
  if (report !== shown) view.move(report);
  shown = report;
  view.draw((now - last) / 1000);
  last = now;
  counted += 1;
  get("toast").hidden ||= now > toastEnds;
  if (now - since > 500) measure(now, report);
}

// Twice a second: numbers for the visitor.
function measure(now, { time, counts, cost, cars }) {
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
  const { visitor, parked, crashed, late } = counts;
  const mine = visitor ? `You parked ${visitor}. ` : "";
  get("status").textContent = `${mine}Policy: ${parked} parked, ${crashed} crashed, ${late} timed out`;
  get("speed").textContent = `${Math.abs(3.6 * cars[0].speed).toFixed(0)} km/h`;
  get("numbers").textContent = [
    `${demo.fps.toFixed(0)} frames/s`, `${demo.rate.toFixed(1)} × real time`,
    `step ${spent("physics", "steps").toFixed(2)} ms`, `decision ${spent("policy", "decisions").toFixed(1)} ms`,
  ].join(" · ");
  [counted, since, before] = [0, now, { time, cost }];
}

new ResizeObserver(() => view.resize(innerWidth, innerHeight)).observe(document.body);
startMeasuring();
requestAnimationFrame(frame);
