// People on foot: each walks between places of the lot and keeps out of the way of cars.

import { distance, local } from "./geometry.js";

export const RADIUS = 0.25; // m
const [PACE, HURRY] = [1.2, 2]; // m/s, of people on their way and in a car's way
const HEADWAY = 2.5; // s that people leave a car
const ROOM = 0.7; // m that they leave it aside, ahead and behind
export const STANDS = 0.1; // m/s, of a car
const BRAKING = 2.5; // m/s^2
const SPARE = 0.3; // m before people when a car has braked
const ARRIVED = 0.3; // m
const WALK = 4; // m, shortest
const PATIENCE = 3; // s of waiting, after which a person heads elsewhere
const LOOK = 0.4; // m between points of a way that are looked at

const inBox = ([u, v], [length, width], room) => Math.abs(u) < length / 2 + room && Math.abs(v) < width / 2 + room;

// A point in the frame of a car; before and behind it, `v` [m] is from the curve that it drives.
function alongCurve(point, { pose, steering }, { size, wheelbase }) {
  const [u, v] = local(point, pose);
  const beyond = Math.max(Math.abs(u) - size[0] / 2, 0);
  return [u, v - (Math.tan(steering) / wheelbase) * beyond ** 2 / 2];
}

function inWay(point, car, inputs) {
  const [u, v] = alongCurve(point, car, inputs);
  const [length, width] = inputs.size;
  const ahead = u * car.speed > 0 ? HEADWAY * Math.abs(car.speed) : 0;
  return Math.abs(u) < length / 2 + ROOM + ahead && Math.abs(v) < width / 2 + ROOM;
}

export class People {
  // `count` people at places of a lot that are far from its cars.
  constructor(count, { starts, inputs }, cars, random) {
    Object.assign(this, { inputs, random });
    this.boxes = ["parked", "wall"].flatMap((kind) =>
      inputs[`${kind}_pose`].map((pose, k) => [pose, inputs[`${kind}_size`][k]])
        .filter((_, k) => inputs[`${kind}_mask`][k]));
    this.places = starts.map(([x, y]) => [x, y]).filter((place) => this.isFree(place));
    const begin = this.places.filter((place) => this.seen(place).length)
      .filter((place) => !cars.some((car) => inWay(place, car, inputs)));
    this.all = Array.from({ length: count }, () => ({ xy: this.pick(begin), waited: PATIENCE }));
  }

  pick(list) {
    return list[Math.floor(this.random() * list.length)];
  }

  isFree(point) {
    return !this.boxes.some(([pose, size]) => inBox(local(point, pose), size, RADIUS));
  }

  // Places at some distance that a clear straight way leads to.
  seen([x, y]) {
    return this.places.filter(([u, v]) => {
      const far = Math.hypot(u - x, v - y);
      const parts = Math.ceil(far / LOOK);
      return far > WALK && Array.from({ length: parts }, (_, k) => (k + 1) / parts)
        .every((share) => this.isFree([x + share * (u - x), y + share * (v - y)]));
    });
  }

  advance(dt, cars) {
    for (const person of this.all) {
      if (person.waited >= PATIENCE || distance(person.xy, person.target) < ARRIVED) {
        Object.assign(person, { target: this.pick(this.seen(person.xy)) ?? person.xy, waited: 0 });
      }
      const next = this.step(person, cars, dt);
      if (next) person.xy = next;
      person.waited = next ? 0 : person.waited + dt;
    }
  }

  // Where a person is after `dt` seconds; null if it waits.
  step({ xy, target }, cars, dt) {
    const [x, y] = xy;
    const near = cars.find((car) => inWay(xy, car, this.inputs));
    const yaw = near
      ? near.pose[2] + Math.sign(alongCurve(xy, near, this.inputs)[1]) * (Math.PI / 2)
      : Math.atan2(target[1] - y, target[0] - x);
    const step = dt * (near ? HURRY : PACE);
    const next = [x + step * Math.cos(yaw), y + step * Math.sin(yaw)];
    const nears = ({ xy: other }) => distance(next, other) < Math.min(3 * RADIUS, distance(xy, other));
    const enters = cars.some((car) => car !== near && inWay(next, car, this.inputs) && !inWay(xy, car, this.inputs));
    return enters || !this.isFree(next) || this.all.some((other) => other.xy !== xy && nears(other)) ? null : next;
  }

  // Whether somebody is so near before a car, or behind one that reverses, that it must brake.
  stops(car) {
    const moves = Math.abs(car.speed) > STANDS;
    const way = Math.sign(moves ? car.speed : car.action[1]);
    const [length, width] = this.inputs.size;
    const reach = length / 2 + RADIUS + SPARE + car.speed ** 2 / (2 * BRAKING);
    return this.all.some(({ xy }) => {
      const [u, v] = alongCurve(xy, car, this.inputs);
      return u * way > 0 && Math.abs(u) < reach && Math.abs(v) < width / 2 + RADIUS;
    });
  }

  // Whether a car drives into somebody.
  hitBy({ pose, speed }) {
    return Math.abs(speed) > STANDS && this.all.some(({ xy }) => inBox(local(xy, pose), this.inputs.size, RADIUS));
  }
}
