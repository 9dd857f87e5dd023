// The editor: buttons, keys, the panel of fields, and the server, which checks and saves.

import { Lot } from "./lot.js";
import { Pointers, TOOLS } from "./tools.js";
import { View } from "./view.js";

const AGAIN = 2000; // ms until a lost server is tried again
const GRID = 0.5; // m, if it is switched on
const ANGLES = [90, 75, 60, 45, 30, 0]; // of bays to the aisle [degrees]
const MOST_PLACES = 3; // that a fault names
const ENDED = "The editor's server has ended: changes are not kept";
const byId = (id) => document.getElementById(id);
const element = (name, properties, ...children) => {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
};
const nameOf = (id) => `${id.replace("/", "[")}]`; // as messages about files have it

const opened = await (await fetch("lot")).json();
let [looks, labels, saved] = [{}, [], JSON.stringify(opened.saved)];
const view = new View(byId("plan"), opened.picture);
const lot = new Lot(opened.document, changed);
const editor = { lot, view, tool: TOOLS[0], grid: GRID, draw, show };
view.fit(lot.document.extent);
const pointers = new Pointers(byId("plan"), editor);

function draw(sketch = {}) {
  view.draw(lot, looks, labels.filter(({ id }) => lot.row(id)), sketch);
}
function show([x, y]) {
  byId("place").textContent = `x ${x.toFixed(2)}, y ${y.toFixed(2)} m`;
}

// Every change is drawn, and sent to the server, which keeps it.
let [sent, busy, waiting] = ["", false, ""];
function changed() {
  draw();
  requestAnimationFrame(showFields); // after the focus has moved on
  if (lot.text !== sent) send("check");
}
async function send(action) {
  if (busy) {
    if (waiting !== "save") waiting = action;
    return;
  }
  [busy, waiting, sent] = [true, "", lot.text];
  const answer = await fetch(action, { method: "POST", body: sent }).catch(() => null);
  const { faults, error } = (await answer?.json()) ?? { error: ENDED };
  if (error) say(error, true);
  else report(action, faults);
  if (!answer) {
    await new Promise((later) => setTimeout(later, AGAIN));
    waiting ||= action;
  }
  busy = false;
  if (waiting) send(waiting);
}
function report(action, faults) {
  const [grave, lost] = ["grave", "unreadable"].map((kind) => faults.some((fault) => fault[kind]));
  if (action === "save" && !grave) saved = sent;
  if (action === "save" || lost) say(grave ? "Not saved: mend the errors first" : "Saved", grave);
  else say(sent === saved ? "No changes" : "Not saved yet, kept as a draft");
  showFaults(faults);
  draw();
}
function say(text, error = false) {
  Object.assign(byId("state"), { textContent: text, className: error ? "error" : "" });
  byId("name").textContent = document.title = `${lot.text === saved ? "" : "• "}${opened.name}`;
}

function showFaults(faults) {
  [looks, labels] = [{}, []];
  const entries = faults.map(({ text, places, grave }) => {
    const [look, ids] = [grave ? "grave" : "warning", places.flat()];
    for (const [id] of places) if (id && !labels.some((label) => label.id === id)) labels.push({ text, id, look });
    for (const id of ids) if (looks[id] !== "grave") looks[id] = look;
    const more = places.length > MOST_PLACES ? `, and ${places.length - MOST_PLACES} more` : "";
    const names = places.slice(0, MOST_PLACES).map((place) => place.map(nameOf).join(" and ")).join(", ") + more;
    const onclick = () => { choose(0); lot.select(ids.filter(lot.row)); };
    return element("li", {}, element("button", { onclick, className: look }, text, " ", element("small", {}, names)));
  });
  byId("faults").replaceChildren(...(entries.length ? entries : [element("li", {}, "No faults.")]));
}

// What the panel shows of a row: a title, where the value is, and its unit.
const FIELDS = {
  x: ["x [m]", "pose", 0], y: ["y [m]", "pose", 1], u: ["x [m]", "centre", 0], v: ["y [m]", "centre", 1],
  heading: ["heading [°]", "pose", 2, Math.PI / 180], angle: ["angle to the aisle [°]", "angle"],
  length: ["length [m]", "size", 0], width: ["width [m]", "size", 1], radius: ["radius [m]", "radius"],
  kind: ["kind", "kind"], end: ["end", "end"], one_way: ["one way", "one_way"], spread: ["spread [rad]", "spread"],
  along_x: ["along x [m]", "extent", 0, 0.5], along_y: ["along y [m]", "extent", 1, 0.5],
};
const valueOf = (row, [, part, k, unit = 1]) => (k === undefined ? row[part] : row[part] && row[part][k] / unit);
function write(row, [, part, k, unit = 1], value) {
  row[part] = k === undefined ? value : row[part].with(k, Number((value * unit).toFixed(6)));
}

// The panel: fields of what is selected, of what the tool draws, or of the ground.
function field(title, value, set, choices) {
  const options = choices?.map((choice) => element("option", { selected: choice === value }, choice));
  const input = choices ? element("select", {}, ...options) : element("input", { type: "number", step: "any" });
  if (typeof value === "boolean") Object.assign(input, { type: "checkbox", checked: value });
  else if (!choices) input.value = Number(value.toFixed(4));
  input.addEventListener("change", () => {
    const typed = input.type === "checkbox" ? input.checked : input.valueAsNumber;
    const given = choices ? choices[input.selectedIndex] : typed;
    if (Number.isNaN(given)) showFields();
    else set(given);
  });
  return element("label", {}, title, input);
}
function fieldsOf(list, rows, names, done) {
  return names.filter((name) => valueOf(rows[0], FIELDS[name]) !== undefined).map((name) => {
    const choices = name === "angle" ? ANGLES : opened.choices[list]?.[name];
    const set = (given) => { rows.forEach((row) => write(row, FIELDS[name], given)); done(); };
    return field(FIELDS[name][0], valueOf(rows[0], FIELDS[name]), set, choices);
  });
}
function showFields() {
  const [ids, rows, { tool }] = [[...lot.selected], lot.rows(), editor];
  const [list] = ids[0]?.split("/") ?? [];
  let [title, shown] = ["Ground", ["ground", [lot.document], ["along_x", "along_y"], () => lot.commit()]];
  if (ids.length) {
    title = ids.length === 1 ? nameOf(ids[0]) : `${ids.length} selected`;
    const names = Object.keys(FIELDS).slice(ids.length === 1 ? 0 : 4); // without x and y
    shown = [list, rows, ids.every((id) => id.startsWith(list)) ? names : [], () => lot.commit()];
  } else if (tool.make) [title, shown] = [tool.name, [tool.list, [tool.model], tool.fields, () => {}]];
  const inputs = () => [...byId("fields").querySelectorAll("input, select")];
  const focused = inputs().indexOf(document.activeElement);
  byId("fields").replaceChildren(element("h2", {}, title), ...fieldsOf(...shown));
  inputs()[focused]?.focus();
  inputs()[focused]?.select?.();
}

function choose(number) {
  editor.tool = TOOLS[number];
  [...byId("tools").children].forEach((button, k) => button.setAttribute("aria-pressed", k === number));
  byId("plan").classList.toggle("select", number === 0);
  byId("hint").textContent = editor.tool.hint;
  lot.select(number ? [] : lot.selected);
}

const move = (dx, dy) => () => { lot.move(dx * (editor.grid || 0.1), dy * (editor.grid || 0.1)); lot.commit(); };
const turn = (degrees) => () => lot.selected.size && lot.turn((degrees / 180) * Math.PI, editor.grid);
const act = {
  undo: lot.undo,
  redo: lot.redo,
  remove: () => lot.remove(),
  duplicate: () => lot.duplicate(editor.grid || GRID),
  turn: turn(90),
  fit: () => { view.fit(lot.document.extent); draw(); },
  grid: () => { byId("grid").value = editor.grid = editor.grid ? 0 : GRID; },
  revert: () => { lot.document = JSON.parse(saved); lot.selected.clear(); lot.commit(); },
  save: () => send("save"),
  all: () => { choose(0); lot.select(lot.ids()); },
  cancel: () => { pointers.cancel(); choose(0); },
};
const KEYS = {
  Delete: act.remove, Backspace: act.remove, Escape: act.cancel, f: act.fit, g: act.grid, r: act.turn, R: turn(15),
  ArrowLeft: move(-1, 0), ArrowRight: move(1, 0), ArrowUp: move(0, 1), ArrowDown: move(0, -1),
};
const CONTROL = { z: act.undo, Z: act.redo, y: act.redo, d: act.duplicate, a: act.all, s: act.save };
addEventListener("keydown", (event) => {
  const control = event.ctrlKey || event.metaKey;
  if (event.altKey || (event.target.matches("input, select") && !(control && event.key === "s"))) return;
  const number = Number(event.key) - 1;
  const work = control ? CONTROL[event.key] : number in TOOLS ? () => choose(number) : KEYS[event.key];
  if (!work) return;
  event.preventDefault();
  if (event.key === "s") document.activeElement.blur(); // takes what is typed
  work();
});
for (const button of document.querySelectorAll("[data-do]")) button.addEventListener("click", act[button.dataset.do]);
TOOLS.forEach(({ name }, k) => {
  byId("tools").append(element("button", { onclick: () => choose(k) }, name, element("kbd", {}, k + 1)));
});
byId("grid").addEventListener("change", () => { editor.grid = Number(byId("grid").value); });
byId("cars").addEventListener("change", () => { view.car = byId("cars").checked ? opened.car : null; draw(); });
for (const [title, command] of opened.commands) byId("next").append(title, element("code", {}, command));
new ResizeObserver(() => { view.show(view.box); draw(); }).observe(byId("plan"));
say("Checking …");
choose(0);
