// Surroundings of the shapes: camera, light, axes and scale; numbers with their units.
import * as THREE from "three";
import { OrbitControls } from "orbit";

const $ = id => document.getElementById(id);
// Directions from the centre to the camera, where z points up.
const VIEWS = { iso: [0.435, -0.819, 0.375], front: [0, -1, 0], side: [1, 0, 0], top: [0, -0.0001, 1] };

// Largest of 1, 2, 5, 10 ... that is not above a number.
export function roundDown(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [5, 2, 1].find(k => k * power <= x * (1 + 1e-9));
}

const UNITS = [[1, "m"], [1e-3, "mm"], [1e-6, "µm"], [1e-9, "nm"], [1e-12, "pm"]];
export const unitOf = length => (UNITS.find(([factor]) => length >= factor) ?? UNITS.at(-1));
export function text(length) {
  const [factor, unit] = unitOf(length);
  return `${Number((length / factor).toPrecision(3))} ${unit}`;
}

const AXES = ["x", "y", "z"];
const unitAlong = axis => new THREE.Vector3().setComponent(AXES.indexOf(axis), 1);

// Colours of the background and of lines, as the browser prefers them.
const PALETTES = {
  light: { paper: "#fbfbfc", outline: "#23272e", edges: "#23272e", rest: "#8a94a3" },
  dark: { paper: "#16191d", outline: "#0b0d10", edges: "#0b0d10", rest: "#7d8796" } };
const dark = matchMedia("(prefers-color-scheme: dark)");

// Calls a function with the colours, now and when the preference changes.
export function withPalette(use) {
  const change = () => use(PALETTES[dark.matches ? "dark" : "light"]);
  dark.addEventListener("change", change);
  change();
}

export const COLORS = ("#440154 #482475 #414487 #355f8d #2a788e #21918c #22a884 #44bf70 #7ad151 #bddf26 #fde725")
  .split(" ").map(text => new THREE.Color(text)); // viridis
const blend = new THREE.Color();

// Colour at a share of the scale; the next call changes it.
export function mixed(share) {
  const place = Math.min(1, share) * (COLORS.length - 1), low = Math.min(COLORS.length - 2, Math.floor(place));
  return blend.lerpColors(COLORS[low], COLORS[low + 1], place - low);
}

// Width of the panel at the left with its margins [pixels].
const PANEL = 270;

export function makeStage({ size, bounds }) {
  const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
  $("scene").append(renderer.domElement);
  const scene = new THREE.Scene();
  withPalette(({ paper }) => { scene.background = new THREE.Color(paper); });
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, -size, 11 * size);
  const light = new THREE.DirectionalLight("#fff", 2.0);
  camera.add(light);
  light.position.set(-0.5, 0.9, 1.2);
  scene.add(camera, new THREE.HemisphereLight("#fff", "#aab", 1.5));
  let controls, draw = () => {};

  // The controls turn the camera about the axis that points up when they are made.
  function setUp(axis) {
    camera.up.copy(unitAlong(axis));
    controls?.dispose();
    controls = new OrbitControls(camera, renderer.domElement);
    controls.addEventListener("change", () => draw());
  }
  // Length of a pixel [m].
  const pixel = () => (camera.top - camera.bottom) / camera.zoom / innerHeight;
  const middle = new THREE.Vector3(...bounds[0]).add(new THREE.Vector3(...bounds[1])).multiplyScalar(0.5);

  function look(name) {
    const upright = new THREE.Quaternion().setFromUnitVectors(unitAlong("z"), camera.up);
    const direction = new THREE.Vector3(...VIEWS[name]).normalize().applyQuaternion(upright);
    camera.position.copy(middle).addScaledVector(direction, 5 * size);
    controls.target.copy(middle);
    camera.lookAt(middle);
    camera.updateMatrixWorld();
    // Zoom so that all corners are visible in the part of the window beside the panels.
    let [across, up] = [0, 0];
    for (let k = 0; k < 8; k++) {
      const corner = new THREE.Vector3(...[0, 1, 2].map(i => bounds[k >> i & 1][i])).sub(middle)
        .applyQuaternion(camera.quaternion.clone().invert());
      [across, up] = [Math.max(across, Math.abs(corner.x)), Math.max(up, Math.abs(corner.y))];
    }
    const width = Math.max(200, innerWidth - 2 * PANEL) / innerHeight, height = Math.max(0.3, 1 - 190 / innerHeight);
    camera.zoom = 0.46 / Math.max(across / width, up / height, 1e-9) * (camera.top - camera.bottom);
    camera.updateProjectionMatrix();
    controls.update();
  }

  function resize() {
    const ratio = innerWidth / innerHeight;
    Object.assign(camera, { left: -size * ratio / 2, right: size * ratio / 2, top: size / 2, bottom: -size / 2 });
    camera.updateProjectionMatrix();
    renderer.setPixelRatio(devicePixelRatio);
    renderer.setSize(innerWidth, innerHeight);
  }

  function drawAxes() {
    const inverse = camera.quaternion.clone().invert();
    const axes = AXES.map(name => ({ name, color: `var(--${name})`, end: unitAlong(name).applyQuaternion(inverse) }));
    $("triad").innerHTML = axes.sort((a, b) => a.end.z - b.end.z).map(({ name, color, end }) =>
      `<line x2="${34 * end.x}" y2="${-34 * end.y}" stroke="${color}" stroke-width="3" stroke-linecap="round"/>` +
      `<text x="${43 * end.x}" y="${-43 * end.y}" fill="${color}">${name}</text>`).join("");
  }

  function drawScale() {
    const length = roundDown(150 * pixel());
    const [label, bar] = $("scale").children;
    label.textContent = `${Number((1e3 * length).toPrecision(3))} mm`;
    bar.style.width = `${length / pixel()}px`;
  }

  setUp("z");
  return { scene, camera, renderer, setUp, look, resize, drawAxes, drawScale, pixel, VIEWS,
    onTurn: action => { draw = action; } };
}
