// Draws a lot: light, ground, cars, the bays that they head for, and the visitor's views.

import * as THREE from "three";
import { OrbitControls } from "./built/three/OrbitControls.js";
import { Geoms } from "./geoms.js";
import { ground } from "./ground.js";
import { RADIUS } from "./people.js";

export const VIEWS = { overview: "Overview", follow: "Behind the car", driver: "Driver's view", plan: "Top view" };
const [FIELD, WIDE] = [40, 62]; // degrees, of a camera and of the driver
const SKY = 0xb9cbd8;
const COARSE = 0.6; // pixels for each of the screen's points on slow machines
const POINTER = 0xffd21f; // of the visitor's arrow and goal
const ARROW = [[-0.9, 0.25], [0.1, 0.25], [0.1, 0.7], [1, 0], [0.1, -0.7], [0.1, -0.25], [-0.9, -0.25]]; // m
const MARK = 0.014; // m, height of a bay's mark above the ground
const CLOTHES = [0xd94f3d, 0x2f6fb0, 0xe0b13c, 0x4d8b57, 0x8a5aa8, 0xe8e4da];

THREE.Object3D.DEFAULT_UP.set(0, 0, 1);

export class View {
  constructor(canvas) {
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    this.scene.fog = new THREE.Fog(SKY, 90, 260);
    this.camera = new THREE.PerspectiveCamera(FIELD, 1, 1, 800);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.maxPolarAngle = 1.45;
    this.orbit.enableDamping = true;
    this.kind = "overview";
    this.addLight();
    this.scene.add(ground());
    this.pin = new THREE.Mesh(new THREE.ConeGeometry(0.6, 1.4, 4).rotateX(-Math.PI / 2), new THREE.MeshBasicMaterial({ color: POINTER }));
    this.arrow = new THREE.Mesh(new THREE.ShapeGeometry(new THREE.Shape(ARROW.map(([x, y]) => new THREE.Vector2(x, y)))),
      new THREE.MeshBasicMaterial({ color: POINTER, side: THREE.DoubleSide, depthTest: false }));
    this.arrow.renderOrder = 1;
    this.scene.add(this.pin, this.arrow);
    this.people = [];
  }

  addLight() {
    this.scene.add(new THREE.HemisphereLight(0xdfeaf5, 0x4a4d45, 1.6));
    this.sun = new THREE.DirectionalLight(0xfff1dc, 2.6);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    this.sun.shadow.bias = -0.0004;
    this.sun.shadow.normalBias = 0.03;
    this.scene.add(this.sun, this.sun.target);
    const [pmrem, sky] = [new THREE.PMREMGenerator(this.renderer), new THREE.Scene()];
    sky.background = new THREE.Color(0xaec2d2);
    const lamp = new THREE.Mesh(new THREE.BoxGeometry(20, 20, 0.1),
      new THREE.MeshBasicMaterial({ color: new THREE.Color(5, 5, 5) }));
    lamp.position.set(0, 4, 12);
    sky.add(lamp);
    this.scene.environment = pmrem.fromScene(sky, 0.05).texture;
    this.scene.environmentIntensity = 0.55;
  }

  // Shows a scene of the simulation in place of the last.
  show(look, lot) {
    if (this.geoms) {
      this.scene.remove(this.geoms.group, ...this.marks);
      this.geoms.delete();
    }
    this.geoms = new Geoms(look);
    this.lot = lot;
    this.marks = lot.start.map((_, car) => mark(this.geoms.paint(car), car ? 0.28 : 0.75));
    this.scene.add(this.geoms.group, ...this.marks);
    const [x, y] = lot.extent;
    const reach = Math.hypot(x, y) + 2;
    this.sun.position.set(-0.45 * reach, -0.6 * reach, reach);
    Object.assign(this.sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 1, far: 4 * reach });
    this.sun.shadow.camera.updateProjectionMatrix();
    this.look(this.kind);
  }

  // Places everything as in a report of the simulation.
  move({ places, cars, people, time }) {
    this.geoms.move(places);
    for (let k = this.people.length; k < people.length; k++) {
      this.people.push(figure(CLOTHES[k % CLOTHES.length]));
      this.scene.add(this.people[k]);
    }
    this.people.forEach((person, k) => {
      person.visible = k < people.length;
      if (person.visible) person.position.set(...people[k], 0);
    });
    cars.forEach((car, k) => {
      const [x, y, yaw] = this.lot.bay_pose[car.goal];
      const [length, width] = this.lot.bay_size[car.goal];
      this.marks[k].position.set(x, y, MARK);
      this.marks[k].rotation.z = yaw;
      this.marks[k].scale.set(length - 0.3, width - 0.3, 1);
    });
    const [[x, y], [u, v]] = [cars[0].pose, this.lot.bay_pose[cars[0].goal]];
    const [far, yaw] = [Math.hypot(u - x, v - y), Math.atan2(v - y, u - x)];
    this.pin.position.set(u, v, 2.6 + 0.2 * Math.sin(4 * time));
    this.pin.rotation.z = time;
    const ahead = Math.min(4.4, far / 2);
    this.arrow.position.set(x + ahead * Math.cos(yaw), y + ahead * Math.sin(yaw), 1);
    this.arrow.rotation.z = yaw;
    this.arrow.visible = far > 4;
    this.car = cars[0].pose;
  }

  // Chooses a camera.
  look(kind) {
    this.kind = kind;
    this.orbit.enabled = kind === "overview";
    const inside = kind === "driver";
    Object.assign(this.camera, { fov: inside ? WIDE : FIELD, near: inside ? 0.4 : 1 });
    this.camera.updateProjectionMatrix();
    if (!this.lot || kind === "follow" || kind === "driver") return;
    const [x, y] = this.lot.extent;
    const turned = x !== y && x > y !== this.camera.aspect > 1; // its long side along the screen's
    const [across, up] = turned ? [y, x] : [x, y];
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const margin = this.camera.aspect > 1 ? 1.12 : 1.25; // of an upright screen the buttons take more
    const far = margin * Math.max(up, across / this.camera.aspect) / half;
    const [back, height] = kind === "plan" ? [0.01, far] : [0.6 * far, 0.86 * far];
    this.camera.position.set(turned ? back : 0, turned ? 0 : -back, height);
    this.orbit.target.set(0, 0, 0);
    this.camera.lookAt(this.orbit.target);
    Object.assign(this.scene.fog, { near: Math.max(90, 1.3 * far), far: Math.max(260, 4 * far) });
  }

  draw(seconds) {
    if (!this.geoms || !this.car) return;
    if (this.kind === "follow") this.follow(1 - Math.exp(-3 * seconds));
    else if (this.kind === "driver") this.sit();
    else if (this.kind === "overview") this.orbit.update();
    this.renderer.render(this.scene, this.camera);
  }

  // Draws the camera a share of the way towards its place behind the visitor's car.
  follow(share) {
    const [x, y, yaw] = this.car;
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const back = this.camera.aspect < 1 ? 13 : 10;
    const wanted = new THREE.Vector3(x - back * c, y - back * s, 0.55 * back);
    this.camera.position.lerp(wanted, this.camera.position.distanceTo(wanted) > 40 ? 1 : share);
    this.camera.lookAt(x + 2.5 * c, y + 2.5 * s, 0.5);
  }

  // Puts the camera on the driver's seat.
  sit() {
    const [x, y, yaw] = this.car;
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const [a, b] = [x - 0.35 * s, y + 0.35 * c];
    this.camera.position.set(a + 0.6 * c, b + 0.6 * s, 1.4);
    this.camera.lookAt(a + 10 * c, b + 10 * s, 0.1);
  }

  // Draws less, for slow machines: first no finer than the screen's points, then without
  // shadows, then coarser.
  simplify() {
    if (this.renderer.getPixelRatio() > 1) this.renderer.setPixelRatio(1);
    else if (this.sun.castShadow) this.sun.castShadow = false;
    else this.renderer.setPixelRatio(COARSE);
  }

  resize(width, height) {
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.look(this.kind);
  }
}

// A person as a body with a head.
function figure(color) {
  const paint = (color) => new THREE.MeshLambertMaterial({ color });
  const body = new THREE.CapsuleGeometry(RADIUS, 1.35 - 2 * RADIUS, 6, 14).rotateX(Math.PI / 2).translate(0, 0, 0.7);
  const head = new THREE.SphereGeometry(0.13, 14, 10).translate(0, 0, 1.55);
  const group = new THREE.Group().add(new THREE.Mesh(body, paint(color)), new THREE.Mesh(head, paint(0xc99a78)));
  for (const mesh of group.children) mesh.castShadow = true;
  return group;
}

function mark(color, opacity) {
  const material = new THREE.MeshBasicMaterial({ color, opacity, transparent: true, depthWrite: false, toneMapped: false });
  return new THREE.Mesh(new THREE.PlaneGeometry(1, 1), material);
}
