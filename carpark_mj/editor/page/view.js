// The plan on the screen: pixels to metres, and all that is drawn.

import { LISTS, poseOf, sizeOf, world } from "./lot.js";

const [HANDLE, STEM, KNOB] = [10, 34, 6]; // px from a row to its handles and knob; their radius
const [LEAST, MOST] = [0.5, 400]; // px per metre
const MARGIN = 1; // m around the ground
const MOST_LABELS = 12;

const escaped = (text) => text.replace(/[&<>"]/g, (sign) => `&#${sign.charCodeAt(0)};`);
const bar = (size, more = "", tag = "rect") => {
  const [x, y] = size.map((side) => Math.max(side, 0)); // what was typed may be wrong
  return `<${tag} x="${-x / 2}" y="${-y / 2}" width="${x}" height="${y}" ${more}/>`;
};

// Directions of lanes and starts, and how cars park; `way` is 1 along the row and -1 against it.
function arrows(list, { size: [length], end, one_way: oneWay }) {
  if (list === "walls") return "";
  const ways = oneWay === false ? [1, -1] : [end === "nose_first" ? -1 : 1];
  const reach = Math.min(1, length / 6);
  return ways.map((way) => {
    const middle = list === "bays" ? length / 4 : (ways.length - 1) * 1.5 * way * reach;
    const [tip, head] = [way * reach, (way * reach) / 2];
    const path = `M${middle - tip} 0h${2 * tip}m${-head} ${-head}l${head} ${head}l${-head} ${head}`;
    return `<path class="arrow ${end ?? ""}" d="${path}"/>`;
  }).join("");
}
function shape(list, row, look) {
  const [[x, y, yaw], classes] = [poseOf(row), `class="${list} ${row.kind ?? ""} ${look}"`];
  if (row.centre) return `<circle cx="${x}" cy="${y}" r="${row.radius}" ${classes}/>`;
  const frame = `translate(${x} ${y}) rotate(${(yaw * 180) / Math.PI})`;
  return `<g transform="${frame}" ${classes}>${bar(row.size)}${arrows(list, row)}</g>`;
}

// A car in every other bay, and one in each spawn region.
function cars({ bays, spawns }, size) {
  const parked = bays.filter((_, k) => k % 2 === 0).map((row) => ["parked", row]);
  return [...parked, ...spawns.map((row) => ["", row])].map(([look, { pose: [x, y, yaw] }]) =>
    `<g transform="translate(${x} ${y}) rotate(${(yaw * 180) / Math.PI})">${bar(size, `rx="0.4" class="car ${look}"`)}</g>`);
}

export class View {
  // `car` is the size of the cars to draw, null for none.
  constructor(svg, picture) {
    Object.assign(this, { svg, picture, car: null });
    [this.ground, this.drawing, this.words] = ["ground", "drawing", "words"].map((id) => svg.getElementById(id));
  }

  get scale() { return this.svg.getScreenCTM().a; } // px per metre

  show(box) {
    this.box = box; // left, top, width and height [m], downwards
    this.svg.setAttribute("viewBox", box.join(" "));
    this.svg.style.setProperty("--px", 1 / this.scale);
  }

  fit = ([x, y]) => this.show([-x - MARGIN, -y - MARGIN, 2 * (x + MARGIN), 2 * (y + MARGIN)]);

  // The point of the world at a pixel of the window.
  world([px, py]) {
    const { x, y } = new DOMPoint(px, py).matrixTransform(this.svg.getScreenCTM().inverse());
    return [x, -y];
  }

  // Zooms, and brings a point of the world to a pixel.
  zoom(factor, pixel, point = this.world(pixel)) {
    const by = Math.min(Math.max(factor * this.scale, LEAST), MOST) / this.scale;
    const [left, top, width, height] = this.box;
    this.show([left, top, width / by, height / by]);
    const [x, y] = this.world(pixel);
    this.show([left + point[0] - x, top - point[1] + y, width / by, height / by]);
  }

  // `looks` are by id; a sketch may have [list, row] `pairs`, points of a `band`, a `label` at a point.
  draw(lot, looks, labels, { pairs = [], band = [], label, at }) {
    const sides = lot.document.extent.map((half) => 2 * half);
    const under = ['class="ground"', 'fill="url(#metre)"', 'fill="url(#five)"'].map((look) => bar(sides, look));
    if (this.picture) under.splice(1, 0, bar(this.picture, 'href="picture" transform="scale(1 -1)"', "image"));
    // Written only where it differs, or the picture flickers.
    if (this.under !== under.join("")) this.ground.innerHTML = this.under = under.join("");
    const rows = LISTS.flatMap((list) => lot.document[list].map((row, k) => {
      const id = `${list}/${k}`;
      return shape(list, row, `${looks[id] ?? ""} ${lot.selected.has(id) ? "selected" : ""}`);
    }));
    const sketch = pairs.map(([list, row]) => shape(list, row, "sketch"));
    sketch.push(`<polygon class="band" points="${band.join(" ")}"/>`);
    const knob = ({ at: [x, y] }) => `<circle class="handle" cx="${x}" cy="${y}" r="${KNOB / this.scale}"/>`;
    this.drawing.innerHTML = [...rows, ...(this.car ? cars(lot.document, this.car) : []), ...sketch, ...this.handles(lot).map(knob)].join("");
    const word = ([x, y], text, look) => `<text x="${x}" y="${-y}" class="${look}">${escaped(text)}</text>`;
    const words = labels.slice(0, MOST_LABELS).map(({ text, id, look }) => word(poseOf(lot.row(id)), text, look));
    this.words.innerHTML = words.join("") + (label ? word(at, label, "size") : "");
  }

  // Where the only selected row is pulled: edges by `axis` and `sign`, or a knob that `turns`.
  handles(lot) {
    if (lot.selected.size !== 1) return [];
    const [row] = lot.rows();
    const edge = (axis, sign, off = HANDLE) => {
      const reach = sign * (sizeOf(row)[axis] / 2 + off / this.scale);
      return { axis, sign, at: world(axis ? [0, reach] : [reach, 0], poseOf(row)) };
    };
    if (row.centre) return [edge(0, 1)];
    return [edge(0, 1), edge(0, -1), edge(1, 1), edge(1, -1), { ...edge(0, 1, STEM), turns: true }];
  }
}
