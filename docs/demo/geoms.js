// Geoms of a MuJoCo scene as three.js meshes: one instanced mesh for all of a kind.

import * as THREE from "three";

const LOOKS = {
  paint: { metalness: 0.35, roughness: 0.32 },
  glass: { metalness: 0.6, roughness: 0.08 },
  metal: { metalness: 0.85, roughness: 0.35 },
  lamp: { roughness: 0.3 },
}; // all else is dull
const [SPHERE, CYLINDER, BOX, MESH] = [2, 5, 6, 7]; // mjtGeom
const FLAT = 0.02; // m, lower geoms cast no shadow

// Unit shapes, which a geom's half sizes scale.
const SHAPES = {
  [SPHERE]: () => new THREE.SphereGeometry(1, 20, 14),
  [CYLINDER]: () => new THREE.CylinderGeometry(1, 1, 2, 24).rotateX(Math.PI / 2),
  [BOX]: () => new THREE.BoxGeometry(2, 2, 2),
};

function meshGeometry({ vertices, faces }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  geometry.setIndex(new THREE.BufferAttribute(faces, 1));
  return geometry; // without normals: its faces are flat
}

function scaleOf({ type, size: [x, y, z] }) {
  if (type === MESH) return [1, 1, 1];
  if (type === SPHERE) return [x, x, x];
  return type === CYLINDER ? [x, x, y] : [x, y, z];
}

const matrix = new THREE.Matrix4();
const scale = new THREE.Vector3();

// The transform of the geom whose 12 numbers (position, row-major rotation) begin at `at`.
function transform(geom, places, at) {
  const [x, y, z, a, b, c, d, e, f, g, h, i] = places.subarray(at, at + 12);
  matrix.set(a, b, c, x, d, e, f, y, g, h, i, z, 0, 0, 0, 1);
  return matrix.scale(scale.fromArray(scaleOf(geom)));
}

export class Geoms {
  constructor({ geoms, meshes, places, moving }) {
    this.group = new THREE.Group();
    this.geoms = geoms;
    this.moving = moving;
    this.slots = [];
    const kinds = Map.groupBy?.(geoms, kindOf) ?? groupBy(geoms, kindOf);
    for (const members of kinds.values()) this.add(members, meshes);
    geoms.forEach((_, k) => this.place(k, places, 12 * k));
    this.update();
  }

  add(members, meshes) {
    const [{ type, mesh, material, rgba, size }] = members;
    if (!(type in SHAPES) && type !== MESH) return; // the ground is drawn by the view
    const shape = type === MESH ? meshGeometry(meshes[mesh]) : SHAPES[type]();
    const common = { flatShading: type === MESH };
    if (rgba[3] < 1) Object.assign(common, { transparent: true, opacity: rgba[3], depthWrite: false });
    const look = material in LOOKS
      ? new THREE.MeshStandardMaterial({ ...LOOKS[material], ...common })
      : new THREE.MeshLambertMaterial(common);
    const instanced = new THREE.InstancedMesh(shape, look, members.length);
    instanced.frustumCulled = false;
    instanced.castShadow = rgba[3] === 1 && (type === MESH ? material !== "" : Math.min(...scaleOf({ type, size })) > FLAT);
    instanced.receiveShadow = rgba[3] === 1;
    const colour = new THREE.Color();
    members.forEach((geom, k) => {
      instanced.setColorAt(k, colour.setRGB(...geom.rgba.slice(0, 3), THREE.SRGBColorSpace));
      this.slots[this.geoms.indexOf(geom)] = [instanced, k];
    });
    this.group.add(instanced);
  }

  place(number, places, at) {
    const slot = this.slots[number];
    if (slot) slot[0].setMatrixAt(slot[1], transform(this.geoms[number], places, at));
  }

  // Moves the geoms that can move.
  move(places) {
    this.moving.forEach((number, k) => this.place(number, places, 12 * k));
    this.update();
  }

  update() {
    for (const mesh of this.group.children) mesh.instanceMatrix.needsUpdate = true;
  }

  // The paint of a car, as a colour.
  paint(car) {
    const geom = this.geoms.find((x) => x.car === car && x.material === "paint");
    return new THREE.Color().setRGB(...geom.rgba.slice(0, 3), THREE.SRGBColorSpace);
  }

  delete() {
    for (const mesh of this.group.children) {
      mesh.geometry.dispose();
      mesh.material.dispose();
      mesh.dispose();
    }
  }
}

const kindOf = ({ type, mesh, material, rgba, size }) =>
  [type, mesh, material, rgba[3] < 1 ? rgba[3] : 1, type === BOX && size[2] < FLAT].join();

function groupBy(list, key) {
  const groups = new Map();
  for (const item of list) groups.set(key(item), [...(groups.get(key(item)) ?? []), item]);
  return groups;
}
