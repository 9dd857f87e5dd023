// The lot: its document, what is selected, and its history. Rows have ids such as "bays/3".
// Metres and radians; a pose is [x, y, yaw] of a centre, a size [length, width].

export const LISTS = ["lanes", "spawns", "bays", "walls", "discs"]; // from the ground up
const DEPTH = 200; // changes that can be undone

const round = (value, digits = 4) => Number(value.toFixed(digits));
export const snapTo = (value, grid) => (grid ? Math.round(value / grid) * grid : value);
export const poseOf = (row) => row.pose ?? [...row.centre, 0];
export const sizeOf = (row) => row.size ?? [2 * row.radius, 2 * row.radius];

// A point of the world in the frame of a pose, and back.
export function local([x, y], [cx, cy, yaw]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)];
}
export function world([u, v], [x, y, yaw]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [x + c * u - s * v, y + s * u + c * v];
}
export function place(row, [x, y, yaw]) {
  if (row.centre) row.centre = [round(x), round(y)];
  else row.pose = [round(x), round(y), round(Math.atan2(Math.sin(yaw), Math.cos(yaw)), 6)];
}
export function resize(row, [length, width]) {
  if (row.centre) row.radius = round(length / 2);
  else row.size = [round(length), round(width)];
}

export class Lot {
  // `changed` is called after every change of the document or of what is selected.
  constructor(document, changed) {
    Object.assign(this, { document, changed, selected: new Set(), past: [], future: [] });
    this.text = JSON.stringify(document);
  }

  ids = () => LISTS.flatMap((list) => this.document[list].map((_, k) => `${list}/${k}`));
  row = (id) => this.document[id.split("/")[0]][id.split("/")[1]];
  rows = () => [...this.selected].map(this.row);

  select(ids) {
    this.selected = new Set(ids);
    this.changed();
  }

  // Records what was done to the document since the last call.
  commit() {
    const text = JSON.stringify(this.document);
    if (text !== this.text) {
      this.past = [...this.past.slice(1 - DEPTH), this.text];
      [this.text, this.future] = [text, []];
    }
    this.changed();
  }

  travel(from, to) {
    if (!from.length) return;
    to.push(this.text);
    this.text = from.pop();
    this.restore();
  }
  undo = () => this.travel(this.past, this.future);
  redo = () => this.travel(this.future, this.past);

  // Drops changes since the last commit.
  restore() {
    this.document = JSON.parse(this.text);
    this.select(this.ids().filter((id) => this.selected.has(id)));
  }

  // Adds [list, row] pairs and selects them.
  add(pairs) {
    this.selected = new Set(pairs.map(([list, row]) => `${list}/${this.document[list].push(row) - 1}`));
    this.commit();
  }

  remove() {
    for (const list of LISTS) {
      this.document[list] = this.document[list].filter((_, k) => !this.selected.has(`${list}/${k}`));
    }
    this.selected.clear();
    this.commit();
  }

  move(dx, dy, rows = this.rows()) {
    for (const [row, [x, y, yaw]] of rows.map((row) => [row, poseOf(row)])) place(row, [x + dx, y + dy, yaw]);
  }

  duplicate(offset) {
    const pairs = [...this.selected].map((id) => [id.split("/")[0], structuredClone(this.row(id))]);
    this.move(offset, -offset, pairs.map(([, row]) => row));
    if (pairs.length) this.add(pairs);
  }

  // Turns about the middle, which is on the grid if there are several rows.
  turn(angle, grid) {
    const poses = this.rows().map(poseOf);
    const mean = [0, 1].map((k) => poses.reduce((sum, pose) => sum + pose[k], 0) / poses.length);
    const middle = poses.length > 1 ? mean.map((x) => snapTo(x, grid)) : mean;
    this.rows().forEach((row, k) => {
      const from = local(poses[k], [...middle, 0]);
      place(row, [...world(from, [...middle, angle]), poses[k][2] + angle]);
    });
    this.commit();
  }

  // The id of the topmost row at a point, or else of the nearest within some metres.
  at(point, slack) {
    const distance = (row) => {
      const [[u, v], [l, w]] = [local(point, poseOf(row)).map(Math.abs), sizeOf(row)];
      return row.centre ? Math.hypot(u, v) - row.radius : Math.max(u - l / 2, v - w / 2);
    };
    const found = this.ids().reverse().map((id) => ({ id, off: Math.max(distance(this.row(id)), 0) }));
    return found.filter(({ off }) => off <= slack).sort((a, b) => a.off - b.off)[0]?.id;
  }
}
