// Asphalt as far as the eye reaches.

import * as THREE from "three";

export function ground() {
  const canvas = Object.assign(document.createElement("canvas"), { width: 256, height: 256 });
  const context = canvas.getContext("2d");
  const pixels = context.createImageData(256, 256);
  for (let k = 0; k < pixels.data.length; k += 4) {
    const grey = 74 + 14 * (Math.random() + Math.random() - 1);
    pixels.data.set([grey, grey + 1, grey + 4, 255], k);
  }
  context.putImageData(pixels, 0, 0);
  const map = new THREE.CanvasTexture(canvas);
  map.wrapS = map.wrapT = THREE.RepeatWrapping;
  map.repeat.set(200, 200);
  map.colorSpace = THREE.SRGBColorSpace;
  map.anisotropy = 8;
  const plane = new THREE.Mesh(new THREE.PlaneGeometry(800, 800),
    new THREE.MeshLambertMaterial({ map }));
  plane.receiveShadow = true;
  return plane;
}
