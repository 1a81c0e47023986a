// Marks of constant width on the screen, which are faint where a shape hides them: dots, rods, arrows, numbers.
import * as THREE from "three";

// Radius of a dot and height of a number [pixels]; opacity of what is hidden.
export const DOT = 4.2;
const NUMBER = 15, HIDDEN = 0.3;
const UP = new THREE.Vector3(0, 1, 0);

// The number of a face, which is turned to the camera; its size is in pixels.
function numberPlate(text) {
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

// A dot or number at each end, a rod between two ends and one for each axis, with an arrowhead for what pushes or measures.
export function drawMark({ kind, name, ends, axes }, color) {
  const object = new THREE.Group(), arrows = ["actuator", "sensor"].includes(kind);
  const material = new THREE.MeshBasicMaterial({ color });
  const behind = new THREE.MeshBasicMaterial({ color, transparent: true, opacity: HIDDEN, depthWrite: false,
    depthFunc: THREE.GreaterDepth });
  const add = (count, geometry) => Array.from({ length: count }, () => {
    const mesh = new THREE.Mesh(geometry, material), hidden = new THREE.Mesh(geometry, behind);
    hidden.renderOrder = 10;
    object.add(mesh.add(hidden));
    return mesh;
  });
  const dots = kind === "face" ? [numberPlate(name)] : add(ends.length, new THREE.SphereGeometry(1, 20, 14));
  if (kind === "face") object.add(...dots);
  const rods = add(axes.length + ends.length - 1, new THREE.CylinderGeometry(1, 1, 1, 10));
  const heads = add(arrows ? axes.length : 0, new THREE.ConeGeometry(1, 1, 14));
  return { object, dots, rods, heads, arrows };
}
