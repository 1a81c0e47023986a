// Parts of the marks in front of the shapes: plates with numbers, and rods.
import * as THREE from "three";

// Height of a plate [pixels].
const NUMBER = 15;
const UP = new THREE.Vector3(0, 1, 0);

// The number of a face, which is turned to the camera; its size is in pixels.
export function numberPlate(text) {
  const canvas = Object.assign(document.createElement("canvas"), { height: 4 * NUMBER });
  const context = canvas.getContext("2d"), font = `bold ${3 * NUMBER}px sans-serif`;
  context.font = font;
  canvas.width = context.measureText(text).width + 1.6 * NUMBER;
  Object.assign(context, { font, textAlign: "center", textBaseline: "middle", fillStyle: "#ffffffd0" });
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = "#222";
  context.fillText(text, canvas.width / 2, canvas.height / 2);
  const map = new THREE.CanvasTexture(canvas);
  map.colorSpace = THREE.SRGBColorSpace;
  const plate = new THREE.Sprite(new THREE.SpriteMaterial({ map }));
  plate.userData.pixels = [canvas.width / 4, NUMBER, 1];
  plate.renderOrder = 10;
  return plate;
}

export function placeRod(rod, from, to, radius) {
  const along = to.clone().sub(from), length = along.length();
  rod.visible = length > 0;
  rod.position.copy(from).addScaledVector(along, 0.5);
  rod.quaternion.setFromUnitVectors(UP, along.normalize());
  rod.scale.set(radius, length, radius);
}
