// Traffic: goals, decisions of the policy, ends and new starts.

import { distance, isParked } from "./geometry.js";
import { People, STANDS } from "./people.js";

export const TICK = 0.01; // s between looks at contacts and bays
const PAUSE = 2.5; // s that a car stands before it begins again
const SPACING = 7.4; // m between a start and other cars, as the policy knows it
const PERSON = -2; // what a car hits, as -1 is what stands
const TAKEN = 1.5; // m from a bay's centre, a car within takes it

const brake = ({ action, speed }) => [action[0], Math.abs(speed) > STANDS ? -Math.sign(speed) : 0];

// Numbers in [0, 1), equal in every visit (mulberry32).
function makeRandom(seed) {
  return () => {
    seed = (seed + 0x6d2b79f5) | 0;
    let t = Math.imul(seed ^ (seed >>> 15), 1 | seed);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

export class Traffic {
  // `decide` gives the action for a car's inputs, `makeInputs` these for a lot's cars and people.
  constructor(physics, about, lot, people, makeInputs, decide) {
    Object.assign(this, { physics, about, lot, makeInputs, decide });
    this.cars = physics.cars;
    this.steps = Math.round(TICK / physics.model.opt.timestep);
    this.perDecision = Math.round(about.decision_time / TICK);
    this.random = makeRandom(1);
    this.people = new People(people, lot, this.cars, this.random);
    this.ticks = 0;
    this.manual = false; // whether the visitor drives car 0
    this.counts = { parked: 0, crashed: 0, late: 0, visitor: 0, bumps: 0 };
    this.seconds = { parked: 0, visitor: 0 }; // of all drives that ended so
    this.events = [];
    this.cost = { steps: 0, physics: 0, decisions: 0, policy: 0 }; // counts and ms
    this.parkedPose = lot.inputs.parked_pose.filter((_, k) => lot.inputs.parked_mask[k]);
    this.cars.forEach((car, k) => this.start(car, lot.goal[k]));
  }

  get time() {
    return this.ticks * TICK;
  }

  start(car, goal) {
    Object.assign(car, { goal, begun: this.time, end: null, stopped: false });
  }

  async tick() {
    if (this.ticks % this.perDecision === 0) await this.decideAll();
    const clock = performance.now();
    this.physics.advance(this.steps);
    this.cost.physics += performance.now() - clock;
    this.cost.steps += this.steps;
    this.ticks += 1;
    this.people.advance(TICK, this.cars);
    for (const [number, other] of this.physics.hits()) this.hit(this.cars[number], other);
    for (const car of this.cars) if (this.people.hitBy(car)) this.hit(car, PERSON);
    for (const car of this.cars) {
      if (car.end) {
        if (this.time >= car.end.until) this.again(car);
      } else if (this.inBay(car)) {
        this.finish(car, "parked");
      } else if (this.time - car.begun > this.about.timeout && !this.visits(car)) {
        this.finish(car, "late");
      }
    }
  }

  visits(car) {
    return this.manual && car.number === 0;
  }

  inBay(car) {
    const { bay_pose, bay_size, inputs } = this.lot;
    return isParked(this.about.rule, car, inputs.size, bay_pose[car.goal], bay_size[car.goal]);
  }

  async decideAll() {
    const driven = this.cars.filter((car) => !car.end && !this.visits(car));
    for (const car of driven) if (this.isTaken(car)) car.goal = this.newGoal(car);
    const inputs = driven.map((car) => this.makeInputs(this.cars, car, this.people.all));
    const clock = performance.now();
    for (const [k, car] of driven.entries()) car.action = await this.decide(inputs[k]);
    for (const car of driven) if (this.people.stops(car)) car.action = brake(car);
    this.cost.policy += performance.now() - clock;
    this.cost.decisions += driven.length;
    this.first ??= driven.map((car, k) => ({ car: car.number, inputs: inputs[k], action: car.action }));
  }

  hit(car, other) {
    const byVisitor = this.manual && (car.number === 0 || other === 0);
    if (this.visits(car)) {
      if (this.time - (car.bumped ?? -9) > PAUSE) {
        this.counts.bumps += 1;
        this.tell(other === PERSON ? "person" : "bumped", car);
      }
      car.bumped = this.time;
    } else if (!car.end) {
      this.finish(car, byVisitor ? "hit" : "crashed");
    }
  }

  finish(car, outcome) {
    car.end = { outcome, until: this.time + PAUSE };
    car.stopped = !this.visits(car);
    const counted = this.visits(car) && outcome === "parked" ? "visitor" : outcome;
    if (counted in this.counts) this.counts[counted] += 1;
    if (counted in this.seconds) this.seconds[counted] += this.time - car.begun;
    this.tell(outcome, car);
  }

  tell(kind, car) {
    const { number, pose, speed, drift, goal, begun } = car;
    this.events.push({ kind, car: number, pose: [...pose], speed, drift, goal, time: this.time, seconds: this.time - begun });
  }

  // A car begins again at another place; the visitor's drives on from its bay.
  again(car, place = !this.visits(car)) {
    if (place) this.physics.place(car, this.newStart(car));
    this.physics.read();
    this.start(car, this.newGoal(car));
  }

  // All cars begin again as at first.
  restart() {
    this.cars.forEach((car, k) => this.physics.place(car, this.lot.start[k]));
    this.physics.read();
    this.cars.forEach((car, k) => this.start(car, this.lot.goal[k]));
  }

  newStart(car) {
    const others = this.cars.filter((other) => other !== car).map((other) => other.pose);
    others.push(...this.people.all.map((person) => person.xy));
    const room = (pose) => Math.min(...others.map((other) => distance(pose, other)));
    const far = this.lot.starts.filter((pose) => room(pose) > SPACING);
    if (far.length) return this.pick(far);
    return this.lot.starts.reduce((a, b) => (room(a) > room(b) ? a : b));
  }

  newGoal(car) {
    const free = this.lot.bay_pose.flatMap((pose, bay) => {
      const stands = (other) => distance(other, pose) < TAKEN;
      const taken = this.parkedPose.some(stands)
        || this.cars.some((other) => other !== car && (other.goal === bay || stands(other.pose)))
        || stands(car.pose);
      return this.lot.bay_usable[bay] && !taken ? [bay] : [];
    });
    return free.length ? this.pick(free) : car.goal;
  }

  isTaken(car) {
    const bay = this.lot.bay_pose[car.goal];
    return this.cars.some((other) => other !== car && distance(other.pose, bay) < TAKEN);
  }

  pick(list) {
    return list[Math.floor(this.random() * list.length)];
  }
}
