// An exported scene in MuJoCo: its cars' state, controls, contacts and places.

const FULL = 0.3; // brake of a full pedal, as in examples/deploy/drive.py
const HOLD = 0.2; // brake of a car that is to stand

export class Physics {
  constructor(mujoco, xml, lot) {
    this.mujoco = mujoco;
    this.model = mujoco.MjModel.from_xml_string(xml);
    this.data = new mujoco.MjData(this.model);
    this.maxSpeed = lot.inputs.max_speed;
    this.rearAxle = lot.inputs.rear_axle;
    this.maxSteering = lot.inputs.max_steering;
    const [model, data] = [this.model, this.data];
    this.start = { qpos: data.qpos.slice(), qvel: data.qvel.slice() };
    this.cars = lot.start.map((pose, number) => this.find(number));
    this.owner = Array.from(model.geom_bodyid, (body) =>
      this.cars.findIndex((car) => car.body === model.body_rootid[body]));
    this.hull = Array.from(model.geom_contype, (type) => type !== 0);
    lot.start.forEach((pose, number) => this.place(this.cars[number], pose));
    mujoco.mj_forward(model, data);
    this.read();
  }

  // Addresses of the car `agentN`.
  find(number) {
    const [model, name] = [this.model, `agent${number}/`];
    const joint = (key) => model.jnt(`${name}${key}`).id;
    const body = model.body(`${name}car`).id;
    const [root, column] = [joint("root"), joint("steer")];
    const joints = [...model.jnt_bodyid.keys()].filter((j) =>
      model.body_rootid[model.jnt_bodyid[j]] === body);
    return {
      number, body, joints,
      qpos: model.jnt_qposadr[root],
      qvel: model.jnt_dofadr[root],
      column: model.jnt_qposadr[column],
      controls: ["steer", "drive", "brake"].map((key) => model.actuator(`${name}${key}`).id),
      action: [0, 0],
    };
  }

  // Puts a car at rest where its footprint's centre is at a pose.
  place(car, [x, y, yaw]) {
    const { model, data } = this;
    for (const j of car.joints) {
      const size = [7, 4, 1, 1][model.jnt_type[j]];
      const freedoms = [6, 3, 1, 1][model.jnt_type[j]];
      const [q, v] = [model.jnt_qposadr[j], model.jnt_dofadr[j]];
      data.qpos.set(this.start.qpos.subarray(q, q + size), q);
      data.qvel.fill(0, v, v + freedoms);
      data.qacc_warmstart.fill(0, v, v + freedoms);
    }
    data.qpos[car.qpos] = x - this.rearAxle * Math.cos(yaw);
    data.qpos[car.qpos + 1] = y - this.rearAxle * Math.sin(yaw);
    data.qpos.set([Math.cos(yaw / 2), 0, 0, Math.sin(yaw / 2)], car.qpos + 3);
    car.action = [0, 0];
  }

  // Poses, speeds and steering of all cars, from MuJoCo's state.
  read() {
    const { qpos, qvel } = this.data;
    for (const car of this.cars) {
      const [w, i, j, k] = qpos.subarray(car.qpos + 3, car.qpos + 7);
      const yaw = Math.atan2(2 * (i * j + w * k), 1 - 2 * (j * j + k * k));
      const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
      const [x, y] = qpos.subarray(car.qpos, car.qpos + 2);
      const [vx, vy] = qvel.subarray(car.qvel, car.qvel + 2);
      car.pose = [x + this.rearAxle * c, y + this.rearAxle * s, yaw];
      car.speed = c * vx + s * vy;
      car.yawRate = qvel[car.qvel + 5];
      car.drift = c * vy - s * vx; // of the rear axle, sideways
      car.steering = qpos[car.column];
    }
  }

  // Holds the cars' actions for a number of steps.
  advance(steps) {
    const { ctrl } = this.data;
    for (const car of this.cars) {
      const [turn, pedal] = car.action;
      const opposed = pedal * car.speed < 0 && Math.abs(car.speed) > 0.1;
      const stands = car.stopped || (Math.abs(pedal) < 0.05 && Math.abs(car.speed) < 0.3);
      const drive = car.speed / this.maxSpeed + (opposed || stands ? 0 : pedal);
      const brake = opposed ? FULL * Math.abs(pedal) : stands ? HOLD : 0;
      const values = [turn * this.maxSteering, drive, brake];
      car.controls.forEach((at, k) => (ctrl[at] = values[k]));
    }
    for (let k = 0; k < steps; k++) this.mujoco.mj_step(this.model, this.data);
    this.read();
  }

  // Numbers of cars whose hulls touch something, and of the cars that they touch (-1 = none).
  hits() {
    const found = [];
    const contacts = this.data.contact;
    for (let k = 0; k < contacts.size(); k++) {
      const contact = contacts.get(k);
      const [a, b] = contact.geom;
      if (this.hull[a] && this.hull[b] && contact.dist < 0) {
        const pair = [this.owner[a], this.owner[b]];
        for (const [car, other] of [pair, [...pair].reverse()]) {
          if (car >= 0) found.push([car, other]);
        }
      }
      contact.delete();
    }
    contacts.delete();
    return found;
  }

  // Positions and rotations of geoms, 12 numbers each.
  places(geoms) {
    const { geom_xpos, geom_xmat } = this.data;
    const out = new Float32Array(12 * geoms.length);
    geoms.forEach((g, k) => {
      out.set(geom_xpos.subarray(3 * g, 3 * g + 3), 12 * k);
      out.set(geom_xmat.subarray(9 * g, 9 * g + 9), 12 * k + 3);
    });
    return out;
  }

  delete() {
    this.data.delete();
    this.model.delete();
  }
}
