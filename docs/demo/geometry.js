// Boxes in the plane: poses [x, y, yaw] in m and rad, sizes [length, width] in m.

export const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);

// A point in the frame of a pose.
export function local([x, y], [cx, cy, yaw]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)];
}

export function corners([x, y, yaw], [length, width]) {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return [[1, 1], [1, -1], [-1, -1], [-1, 1]].map(([a, b]) => {
    const [u, v] = [(a * length) / 2, (b * width) / 2];
    return [x + c * u - s * v, y + s * u + c * v];
  });
}

// The library's strict rule: within the bay's lines, along it either way, and slow.
export function isParked(rule, car, size, bayPose, baySize) {
  const inside = corners(car.pose, size).every((corner) => {
    const [u, v] = local(corner, bayPose);
    return Math.abs(u) <= baySize[0] / 2 && Math.abs(v) <= baySize[1] / 2;
  });
  const turned = Math.abs(Math.asin(Math.sin(car.pose[2] - bayPose[2])));
  return inside && turned < rule.heading && Math.hypot(car.speed, car.drift) < rule.speed;
}
