// Inputs of the model by name, as flat arrays.

import { RADIUS } from "./people.js";

const ARRAYS = { float32: Float32Array, int32: Int32Array, bool: Uint8Array };

// Names, types and shapes of the inputs, and those that are constant in a lot.
export function makeInputs(about, lot) {
  const constant = {};
  for (const [name, value] of Object.entries(lot.inputs)) {
    constant[name] = [value].flat(Infinity).map(Number);
  }
  return (cars, own, people) => {
    const others = cars.filter((car) => car !== own);
    const values = {
      ...constant,
      pose: own.pose,
      speed: [own.speed],
      yaw_rate: [own.yawRate],
      steering: [own.steering],
      goal_pose: lot.bay_pose[own.goal],
      goal_size: lot.bay_size[own.goal],
      other_pose: others.flatMap((car) => car.pose),
      other_size: others.flatMap(() => constant.size),
      other_speed: others.map((car) => car.speed),
      other_steering: others.map((car) => car.steering),
      other_max_steering: others.flatMap(() => constant.max_steering),
      other_goal: others.flatMap((car) => lot.bay_pose[car.goal].slice(0, 2)),
      other_priority: others.map((car) => Number(car.number < own.number)),
      other_mask: others.map(() => 1),
      disc_centre: people.flatMap((person) => person.xy),
      disc_radius: people.map(() => RADIUS),
      disc_mask: people.map(() => 1),
    };
    const filled = {};
    for (const [name, [type, ...shape]] of Object.entries(about.inputs)) {
      const array = new ARRAYS[type](shape.reduce((a, b) => a * b, 1));
      array.set(values[name]); // rows that are missing stay 0, and masked
      filled[name] = { type, shape, array };
    }
    return filled;
  };
}
