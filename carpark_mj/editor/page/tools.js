// The tools: what they draw from one point to another, each after a row as its model, and what pointers do.

import { local, place, poseOf, resize, sizeOf, snapTo, world } from "./lot.js";

const TURN = Math.PI / 12; // a step of angles
const [LEAST, STEP] = [0.1, 0.05]; // m of a side; of a radius
const [MOUSE, TOUCH, KNOB] = [6, 14, 4]; // px around what they hit, and more around handles
const length = (a, b) => Math.hypot(b[0] - a[0], b[1] - a[1]);
const heading = (a, b) => Math.atan2(b[1] - a[1], b[0] - a[0]);

function like(model, pose, size) {
  const row = structuredClone(model);
  place(row, pose);
  resize(row, size);
  return row;
}

// A rectangle along a line.
function strip(a, b, model) {
  const middle = [0, 1].map((k) => (a[k] + b[k]) / 2);
  return length(a, b) < LEAST ? [] : [like(model, [...middle, heading(a, b)], [length(a, b), model.size[1]])];
}

// A rectangle between two corners; cars start along its longer side, the way it was drawn.
function corners(a, b, model) {
  const [x, y] = [b[0] - a[0], b[1] - a[1]];
  const sides = [x, y].map(Math.abs).sort((p, q) => q - p);
  const yaw = Math.abs(x) >= Math.abs(y) ? heading([0, 0], [x, 0]) : heading([0, 0], [0, y]);
  return sides[1] < LEAST ? [] : [like(model, [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2, yaw], sides)];
}

// A bay at a point, heading for another one, as the next bays will.
function bay(a, b, model) {
  if (length(a, b) > LEAST) place(model, [0, 0, heading(a, b)]);
  return [like(model, [...a, model.pose[2]], model.size)];
}

// Bays on the left of a line, the edge of the aisle, at an angle; cars enter them driving along it.
function bays(a, b, model) {
  const [[long, wide], angle] = [model.size, model.angle / (180 / Math.PI)];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const [along, deep] = [long * c + wide * s, long * s + wide * c];
  const pitch = angle ? wide / s : long;
  const count = Math.floor((length(a, b) - along) / pitch + 1 + 1e-6);
  const yaw = heading(a, b) + (angle ? angle - Math.PI : 0);
  const { angle: _, ...plain } = model;
  return Array.from({ length: Math.max(count, 0) }, (_, k) =>
    like(plain, [...world([along / 2 + k * pitch, deep / 2], [...a, heading(a, b)]), yaw], plain.size));
}

const pillar = (a, b, model) => [like(model, [...a, 0], [2 * model.radius])];

const box = (size, rest) => ({ pose: [0, 0, -Math.PI / 2], size, ...rest });
const BAY = { kind: "standard", end: "either" };
const SIDES = ["length", "width", "kind", "end"];
// `fields` of the model are in the panel; `point`: drawn where the pointer is pressed.
export const TOOLS = [
  { name: "Select", hint: "Click or drag a frame to select, drag to move, pull handles to resize and turn." },
  { name: "Row of bays", list: "bays", make: bays, model: box([5, 2.5], { ...BAY, angle: 90 }),
    fields: ["angle", ...SIDES],
    hint: "Drag along the edge of the aisle: bays fill its left; drag the other way for the other side." },
  { name: "Bay", list: "bays", make: bay, point: true, model: box([5, 2.5], BAY),
    fields: ["heading", ...SIDES], hint: "Press at the bay's centre and drag towards the aisle." },
  { name: "Wall", list: "walls", make: strip, model: box([1, 0.2], { kind: "wall" }),
    fields: ["width", "kind"], hint: "Drag from end to end." },
  { name: "Kerb", list: "walls", make: strip, model: box([1, 0.2], { kind: "kerb" }),
    fields: ["width", "kind"], hint: "Drag from end to end." },
  { name: "Pillar", list: "discs", make: pillar, point: true, model: { centre: [0, 0], radius: 0.25, kind: "pillar" },
    fields: ["radius", "kind"], hint: "Click at the centre." },
  { name: "Lane", list: "lanes", make: strip, model: box([1, 6], { one_way: false }),
    fields: ["width", "one_way"], hint: "Drag along the centre line, in the direction of travel." },
  { name: "Spawn region", list: "spawns", make: corners, model: box([1, 2], { spread: 0.1 }), fields: ["spread"],
    hint: "Drag from corner to corner. Centres of cars start inside, heading along the longer side; R turns it." },
];

export class Pointers {
  // `editor` has lot, view, tool, grid, draw(sketch) and show(point).
  constructor(svg, editor) {
    Object.assign(this, { editor, fingers: new Map(), drag: null }); // drag(event, point) returns a sketch
    const listen = (name, work) => svg.addEventListener(name, (event) => work(event, [event.clientX, event.clientY]));
    for (const name of ["down", "move", "up"]) listen(`pointer${name}`, (event, pixel) => this[name](event, pixel));
    listen("pointercancel", (event) => { this.cancel(); this.up(event); });
    listen("contextmenu", (event) => event.preventDefault());
    listen("wheel", (event, pixel) => {
      event.preventDefault();
      editor.view.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), pixel);
      editor.draw();
    });
  }

  cancel() {
    this.drag = null;
    this.editor.lot.restore();
  }

  made = (a, b) => this.editor.tool.make(a, b, this.editor.tool.model).map((row) => [this.editor.tool.list, row]);
  grid = (event) => (event.altKey ? 0 : this.editor.grid);
  snap = (event, point) => point.map((x) => snapTo(x, this.grid(event)));

  down(event, pixel) {
    const { view, tool } = this.editor;
    view.svg.setPointerCapture(event.pointerId);
    view.svg.focus();
    this.fingers.set(event.pointerId, pixel);
    const point = view.world(pixel);
    if (this.fingers.size > 1) this.pinch();
    else if (event.button) this.drag = (now) => view.zoom(1, [now.clientX, now.clientY], point);
    else this.drag = tool.make ? this.drawing(this.snap(event, point)) : this.selecting(event, point);
    this.move(event, pixel);
  }

  move(event, pixel) {
    const { view, tool, draw, show } = this.editor;
    if (this.fingers.has(event.pointerId)) this.fingers.set(event.pointerId, pixel);
    const point = view.world(pixel);
    const at = this.snap(event, point);
    show(at);
    if (this.drag) draw(this.drag(event, point));
    else if (tool.point && event.pointerType === "mouse") draw({ pairs: this.made(at, at) });
  }

  up(event) {
    const { drag, editor: { lot } } = this;
    this.fingers.delete(event.pointerId);
    this.drag = null;
    if (drag?.pairs?.length) lot.add(drag.pairs);
    else lot.commit();
  }

  // Two fingers move and zoom the view.
  pinch() {
    this.cancel();
    const { view } = this.editor;
    const state = () => {
      const [[ax, ay], [bx, by]] = this.fingers.values();
      return { pixel: [(ax + bx) / 2, (ay + by) / 2], apart: Math.hypot(ax - bx, ay - by) };
    };
    let { pixel, apart } = state();
    const point = view.world(pixel);
    this.drag = () => {
      if (this.fingers.size < 2) return;
      const now = state();
      view.zoom(now.apart / apart, now.pixel, point);
      apart = now.apart;
    };
  }

  drawing(a) {
    const { tool } = this.editor;
    const drag = (event, point) => {
      let b = this.snap(event, point);
      if (event.shiftKey) b = world([length(a, b), 0], [...a, snapTo(heading(a, b), TURN)]);
      const pairs = (drag.pairs = this.made(a, b));
      if (tool.point) return { pairs };
      const count = pairs.length === 1 ? "" : `${pairs.length} bays, `;
      const size = tool.make === corners
        ? [0, 1].map((k) => Math.abs(b[k] - a[k]).toFixed(2)).join(" × ") : `${count}${length(a, b).toFixed(2)}`;
      return { pairs, band: [a, b], label: `${size} m`, at: b };
    };
    return drag;
  }

  selecting(event, start) {
    const { lot, view } = this.editor;
    const reach = event.pointerType === "touch" ? TOUCH : MOUSE;
    const handle = view.handles(lot).find(({ at }) => length(at, start) * view.scale < reach + KNOB);
    if (handle) return this.pulling(lot.rows()[0], handle);
    const id = lot.at(start, reach / view.scale);
    const kept = event.shiftKey ? [...lot.selected] : [];
    // Frames may begin on a lane, which a click selects.
    if (!id || (id.startsWith("lanes") && !lot.selected.has(id))) return this.framing(start, kept, id ? [id] : []);
    if (event.shiftKey && lot.selected.has(id)) lot.select(kept.filter((other) => other !== id));
    else if (!lot.selected.has(id)) lot.select([...kept, id]);
    return this.moving(start);
  }

  moving(start) {
    const origins = this.editor.lot.rows().map((row) => [row, poseOf(row)]);
    return (event, point) => {
      const [dx, dy] = this.snap(event, [point[0] - start[0], point[1] - start[1]]);
      for (const [row, [x, y, yaw]] of origins) place(row, [x + dx, y + dy, yaw]);
    };
  }

  pulling(row, { axis, sign, turns }) {
    const [pose, size] = [poseOf(row), sizeOf(row)];
    return (event, point) => {
      if (turns) {
        place(row, [pose[0], pose[1], snapTo(heading(pose, point), this.grid(event) && TURN)]);
        return { label: `${((poseOf(row)[2] * 180) / Math.PI).toFixed(1)}°`, at: point };
      }
      const to = sign * local(point, pose)[axis];
      const side = Math.max(row.centre ? 2 * snapTo(to, STEP) : snapTo(to + size[axis] / 2, this.grid(event)), LEAST);
      resize(row, size.with(axis, side));
      if (!row.centre) place(row, [...world([0, 0].with(axis, (sign * (side - size[axis])) / 2), pose), pose[2]]);
      return { label: `${(row.centre ? side / 2 : side).toFixed(2)} m`, at: point };
    };
  }

  framing([x, y], kept, clicked) {
    const { lot, view } = this.editor;
    lot.select([...kept, ...clicked]);
    const between = (value, a, b) => value >= Math.min(a, b) && value <= Math.max(a, b);
    return (event, [u, v]) => {
      if (length([x, y], [u, v]) * view.scale < MOUSE) return {};
      const framed = lot.ids().filter((id) => {
        const [p, q] = poseOf(lot.row(id));
        return between(p, x, u) && between(q, y, v);
      });
      lot.selected = new Set([...kept, ...framed]);
      return { band: [[x, y], [u, y], [u, v], [x, v]] };
    };
  }
}
