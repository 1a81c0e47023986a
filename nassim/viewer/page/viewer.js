// Shows a view: shapes, marks, modes, a motion. Lengths are in metres, rotations in radians.
import * as THREE from "three";
import { DOT, drawMark, placeRod } from "marks";
import { COLORS, makeStage, mixed, roundDown, text, unitOf, withPalette } from "stage";

const header = JSON.parse(document.getElementById("header").textContent);
const bytes = await unpack(document.getElementById("data").textContent);
const KINDS = { float32: Float32Array, float64: Float64Array, int16: Int16Array, uint8: Uint8Array, uint32: Uint32Array };
const array = where => new KINDS[where.kind](bytes, where.offset, where.length);
const $ = id => document.getElementById(id);
const element = (tag, fields) => Object.assign(document.createElement(tag), fields);
const { size, modes, motion, coloring } = header;
const time = motion && array(motion.time);
const REST = new THREE.Quaternion();
const largestTrue = () => header.small ? motion.largest : motion.largest_deformation;

// State of the page. phase: angle in the period of a mode; frame: index of an image of a motion.
const state = { mode: header.first_mode, frame: 0, phase: Math.PI / 2, amplitude: 0.06, magnification: 1,
  playing: false, speed: 1, clock: 0, colored: Boolean(coloring) };
const moves = modes.length > 0 || Boolean(motion && (largestTrue() || coloring));

// ---- forms and shapes

const forms = header.forms.map(form => {
  const points = array(form.points), values = array(form.patterns.values);
  return { points, labels: form.labels, triangles: array(form.triangles), label: array(form.label),
    outline: array(form.outline), edges: array(form.edges), scales: form.patterns.scales,
    patterns: form.patterns.scales.map((_, k) => values.subarray(k * points.length, (k + 1) * points.length)) };
});

const shapes = header.shapes.map(item => {
  const form = forms[item.form], moved = motion?.moved[item.name];
  return { ...item, form, values: item.values && array(item.values),
    turn: new THREE.Quaternion(...item.rotation), place: new THREE.Vector3(...item.position),
    moved: moved && Object.fromEntries(Object.entries(moved).map(([key, where]) => [key, array(where)])),
    deformation: new Float32Array(form.points.length), drawn: new Float32Array(form.points) };
});
const named = Object.fromEntries(shapes.map(shape => [shape.name, shape]));

// Coordinates of the patterns of a shape in the current mode or image; modes have a largest displacement of 1 m.
function coordinates(shape) {
  if (modes.length) return modes[state.mode].coordinates[shape.name] ?? [];
  const values = shape.moved?.coordinates, count = shape.form.scales.length;
  return values ? values.subarray(state.frame * count, (state.frame + 1) * count) : [];
}

function deform(shape) {
  const { patterns, scales } = shape.form, target = shape.deformation;
  target.fill(0);
  coordinates(shape).forEach((value, k) => {
    const factor = value * scales[k], pattern = patterns[k];
    if (factor) for (let i = 0; i < target.length; i++) target[i] += factor * pattern[i];
  });
}

// Magnified translation from rest, and rotation about the shape's own axes, in the current image.
function rigid(shape, factor) {
  const at = values => values ? new THREE.Vector3().fromArray(values, 3 * state.frame) : new THREE.Vector3();
  const turn = at(shape.moved?.turn), angle = turn.length() * factor;
  const quaternion = angle ? new THREE.Quaternion().setFromAxisAngle(turn.normalize(), angle) : REST.clone();
  return { shift: at(shape.moved?.shift).multiplyScalar(factor), quaternion };
}

// Displacement of a point from rest along the world's axes: without magnification, modes with their own amplitude.
function displacement(shape, index) {
  const moved = new THREE.Vector3().fromArray(shape.deformation, 3 * index);
  if (modes.length) return moved.multiplyScalar(modes[state.mode].peak).applyQuaternion(shape.turn);
  const x = new THREE.Vector3().fromArray(shape.form.points, 3 * index), { shift, quaternion } = rigid(shape, 1);
  return moved.add(x).applyQuaternion(quaternion).sub(x).applyQuaternion(shape.turn).add(shift);
}

// ---- three.js

const { scene, camera, renderer, setUp, look, resize, drawAxes, drawScale, pixel, VIEWS, onTurn } = makeStage(header);
onTurn(draw);

const line = opacity => new THREE.LineBasicMaterial({ opacity, transparent: opacity < 1 });
const LINES = { outline: line(1), edges: line(0.22), rest: line(0.9) };

for (const shape of shapes) {
  const { form } = shape, attribute = new THREE.BufferAttribute(shape.drawn, 3);
  shape.group = new THREE.Group();
  shape.color = new THREE.BufferAttribute(new Float32Array(form.points.length).fill(1), 3);
  const geometry = index => {
    const result = new THREE.BufferGeometry().setAttribute("position", attribute);
    // Shapes move, so that they must not be culled by their position at rest.
    result.boundingSphere = new THREE.Sphere(new THREE.Vector3(), Infinity);
    return result.setIndex(new THREE.BufferAttribute(index, 1));
  };
  shape.parts = form.labels.map((label, number) => {
    const own = Array.from(form.label.keys()).filter(k => form.label[k] === number);
    const index = new Uint32Array(own.flatMap(k => [...form.triangles.subarray(3 * k, 3 * k + 3)]));
    const material = new THREE.MeshLambertMaterial({ side: THREE.DoubleSide, flatShading: true,
      polygonOffset: true, polygonOffsetFactor: 1.5, polygonOffsetUnits: 4 });
    const mesh = new THREE.Mesh(geometry(index).setAttribute("color", shape.color), material);
    Object.assign(mesh.userData, { shape, label, color: shape.colors[number] });
    return mesh;
  });
  shape.lines = Object.fromEntries(["outline", "edges"].map(kind =>
    [kind, new THREE.LineSegments(geometry(form[kind]), LINES[kind])]));
  shape.lines.edges.visible = false;
  shape.group.add(...shape.parts, ...Object.values(shape.lines));
  const resting = new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(form.points, 3));
  shape.rest = new THREE.LineSegments(resting.setIndex(new THREE.BufferAttribute(form.outline, 1)), LINES.rest);
  shape.rest.position.copy(shape.place);
  shape.rest.quaternion.copy(shape.turn);
  shape.rest.visible = moves;
  scene.add(shape.group, shape.rest);
}
const meshes = shapes.flatMap(shape => shape.parts);

const marks = header.marks.map(mark => {
  const drawn = drawMark(mark, header.kinds[mark.kind]);
  scene.add(drawn.object);
  return { ...mark, ...drawn, ends: mark.ends.map(([shape, index]) => ({ shape: named[shape], index })) };
});

const drawnAt = ({ shape, index }) => shape.group.localToWorld(new THREE.Vector3().fromArray(shape.drawn, 3 * index));

function placeMarks() {
  const unit = pixel(), toCamera = camera.getWorldDirection(new THREE.Vector3()).negate();
  for (const mark of marks) {
    const ends = mark.ends.map(drawnAt), last = ends.at(-1);
    mark.places = ends;
    mark.segments = ends.length > 1 ? [[ends[0], ends[1]]] : [];
    mark.dots.forEach((dot, k) => {
      const { pixels } = dot.userData;
      dot.position.copy(ends[k]);
      // Numbers on the far side of bodies are hidden. On the near side, the face must not cut them.
      if (pixels) dot.position.addScaledVector(toCamera, 0.5 * pixels[0] * unit);
      dot.scale.set(...(pixels ?? [DOT, DOT, DOT])).multiplyScalar(unit);
    });
    mark.axes.forEach(axis => {
      const direction = new THREE.Vector3(...axis), reach = 26 * unit;
      if (mark.frame) direction.applyQuaternion(named[mark.frame].group.quaternion);
      const tail = last.clone().addScaledVector(direction, mark.arrows ? 0 : -reach);
      mark.segments.push([tail, last.clone().addScaledVector(direction, mark.arrows ? 1.5 * reach : reach)]);
    });
    mark.rods.forEach((rod, k) => placeRod(rod, ...mark.segments[k], 1.1 * unit));
    const arrows = mark.segments.slice(mark.segments.length - mark.heads.length);
    mark.heads.forEach((head, k) => {
      const [from, to] = arrows[k];
      placeRod(head, to.clone().lerp(from, 0.3), to.clone().lerp(from, -0.05), 4 * unit);
    });
  }
}

// ---- update of the shapes from the state

const largestShown = () => modes.length ? state.amplitude * size : largestTrue();

function update({ deformed = true } = {}) {
  const swing = modes.length ? state.amplitude * size * Math.sin(state.phase) : state.magnification;
  for (const shape of shapes) {
    if (deformed) deform(shape);
    const { points } = shape.form, { drawn, deformation } = shape;
    for (let i = 0; i < drawn.length; i++) drawn[i] = points[i] + swing * deformation[i];
    shape.parts[0] && (shape.parts[0].geometry.attributes.position.needsUpdate = true);
    const { shift, quaternion } = rigid(shape, header.small ? state.magnification : 1);
    shape.group.position.copy(shape.place).add(shift);
    shape.group.quaternion.copy(shape.turn).multiply(quaternion);
    shape.group.updateMatrixWorld();
    if (deformed && state.colored) paint(shape);
  }
  draw();
}

// Colours show a quantity in 256 steps, or displacements (in large motion deformations); those of a mode at its largest
// amplitude.
function paint(shape) {
  const { values, deformation, form } = shape, count = values ? values.length / time.length : 0;
  const whole = motion && header.small, most = modes.length ? 1 : largestTrue() || 1;
  const length = i => whole ? displacement(shape, i).length() : Math.hypot(...deformation.subarray(3 * i, 3 * i + 3));
  const share = i => coloring ? (values?.[state.frame * count + i] ?? 0) / 255 : length(i) / most;
  for (let i = 0; i < form.points.length / 3; i++) mixed(share(i)).toArray(shape.color.array, 3 * i);
  shape.color.needsUpdate = true;
}

function recolor() {
  for (const { material, userData } of meshes) {
    material.vertexColors = state.colored;
    material.color.set(state.colored ? "#fff" : userData.color);
    material.needsUpdate = true;
  }
  $("colors").hidden = !state.colored;
  update();
}

function writeFigures() {
  if (!modes.length && !motion) return;
  const largest = coloring?.largest ?? largestShown(), [factor, unit] = coloring ? [1] : unitOf(largest);
  $("quantity").textContent = coloring?.quantity ?? `${header.small ? "displacement" : "deformation"} [${unit}]`;
  const figures = coloring?.ticks ?? [0, 0.25, 0.5, 0.75, 1].map(share => share * largest / factor);
  $("figures").replaceChildren(...figures.toReversed().map(f => element("span", { textContent: Number(f.toPrecision(3)) })));
  $("mode-text").textContent = modes[state.mode]?.text ?? "";
  $("amplitude-text").textContent = `${text(state.amplitude * size)}; the amplitude of a mode is arbitrary`;
  $("magnification-text").textContent = `× ${Number(state.magnification.toPrecision(2)).toLocaleString("en")}`;
  $("play").textContent = state.playing ? "pause" : "play";
  if (motion) {
    $("time").textContent = `${time[state.frame].toFixed(digits)} s`;
    $("frame").value = state.frame;
    const [before, times] = state.speed >= 1 ? ["", state.speed] : ["1/", 1 / state.speed];
    $("speed-text").textContent = `${before}${Number(times.toPrecision(2))} × real time`;
  }
}
const digits = motion ? Math.max(0, Math.min(6, 1 - Math.floor(Math.log10((time.at(-1) - time[0]) / (time.length - 1))))) : 0;

// ---- rendering
let wanted = false;
function draw() {
  if (wanted) return;
  wanted = true;
  requestAnimationFrame(() => {
    wanted = false;
    placeMarks();
    renderer.render(scene, camera);
    drawAxes();
    drawScale();
    writeFigures();
  });
}

// ---- controls

function addSwitch(box, name, color, on, changed) {
  const row = element("label"), input = element("input", { type: "checkbox", checked: on });
  input.addEventListener("change", () => { changed(input.checked); draw(); });
  row.append(input, ...(color ? [element("span", { className: "swatch", style: `background:${color}` })] : []),
    element("span", { className: "name", textContent: name, title: name }));
  $(box).append(row);
}

const seen = shapes.filter(shape => shape.parts.length);
if (seen.length === 1) {
  const order = new Intl.Collator(undefined, { numeric: true });
  for (const mesh of [...seen[0].parts].sort((a, b) => order.compare(a.userData.label, b.userData.label))) {
    addSwitch("parts", mesh.userData.label, mesh.userData.color, true, on => { mesh.visible = on; });
  }
} else {
  // With many shapes, those of one placed scene (equal name before the slash) share one switch.
  const groups = Object.groupBy(seen, ({ name }) => seen.length > 12 ? name.split("/")[0] : name);
  for (const [name, items] of Object.entries(groups)) {
    addSwitch("parts", name, items[0].colors[0], true, on => { for (const { group } of items) group.visible = on; });
  }
}
for (const kind of new Set(marks.map(mark => mark.kind))) {
  addSwitch("switches", `${kind}s`, header.kinds[kind], true, on => {
    for (const mark of marks) if (mark.kind === kind) mark.object.visible = on;
  });
}
const everywhere = change => on => shapes.forEach(shape => change(shape, on));
addSwitch("switches", "edges", null, true, everywhere((shape, on) => { shape.lines.outline.visible = on; }));
addSwitch("switches", "mesh", null, false, everywhere((shape, on) => { shape.lines.edges.visible = on; }));
// The box of a stator's inertia may hide a body at rest. Its surface counts, not points of marks, which may lie far off.
const surface = ({ points, triangles }) => Array.from(triangles, k => new THREE.Vector3().fromArray(points, 3 * k));
function encloses(outer, inner) {
  const box = new THREE.Box3().setFromPoints(surface(outer.form)), toOuter = outer.turn.clone().invert();
  return surface(inner.form).every(point => box.containsPoint(
    point.applyQuaternion(inner.turn).add(inner.place).sub(outer.place).applyQuaternion(toOuter)));
}
const boxes = seen.filter(shape => shape.form.triangles.length === 3 * 12);
const hidden = boxes.some(outer => seen.some(inner => inner !== outer && encloses(outer, inner)));
const seeThrough = on => {
  const change = { transparent: on, opacity: on ? 0.35 : 1, depthWrite: !on, needsUpdate: true };
  for (const { material } of meshes) Object.assign(material, change);
};
addSwitch("switches", "see-through", null, hidden, seeThrough);
seeThrough(hidden);
if (moves) {
  addSwitch("switches", "outline at rest", null, true, everywhere((shape, on) => { shape.rest.visible = on; }));
  const label = coloring ? "colours" : "colour by size";
  addSwitch("switches", label, null, state.colored, on => { state.colored = on; recolor(); });
}
for (const name of Object.keys(VIEWS)) {
  const button = element("button", { textContent: name });
  button.addEventListener("click", () => { look(name); draw(); });
  $("up").before(button);
}
$("up").addEventListener("change", () => { setUp($("up").value); look("iso"); draw(); });

function slider(id, value, changed) {
  $(id).value = value;
  $(id).addEventListener("input", () => changed(Number($(id).value)));
}

function play(on) {
  state.playing = on;
  state.last = performance.now();
  if (on) requestAnimationFrame(advance);
  else if (modes.length) state.phase = Math.PI / 2;
  update({ deformed: false });
}

function advance(now) {
  if (!state.playing) return;
  const passed = Math.min(0.1, Math.max(0, (now - state.last) / 1e3));
  state.last = now;
  if (modes.length) {
    state.phase += passed * Math.PI; // one period in two seconds
    update({ deformed: false });
  } else {
    state.clock = (state.clock + passed * state.speed) % (time.at(-1) - time[0] || 1);
    show(time.findLastIndex(t => t <= time[0] + state.clock));
  }
  requestAnimationFrame(advance);
}

function show(frame) {
  state.frame = Math.max(0, Math.min(time.length - 1, frame));
  update();
}

if (modes.length) {
  $("mode").replaceChildren(...modes.map(({ name }) => element("option", { textContent: name })));
  $("mode").selectedIndex = state.mode;
  $("mode").addEventListener("change", () => { state.mode = $("mode").selectedIndex; update(); });
  slider("amplitude", 100 * state.amplitude, value => { state.amplitude = value / 100; update({ deformed: false }); });
  $("mode-box").hidden = $("player").hidden = false;
  $("frame").hidden = $("speed-box").hidden = true;
}
if (motion) {
  state.magnification = largestTrue() ? Math.min(1e8, Math.max(1, roundDown(0.04 * size / largestTrue()))) : 1;
  state.speed = 10 ** Math.max(-4, Math.min(1, Math.log10((time.at(-1) - time[0]) / 10 || 1)));
  $("magnified").textContent = header.small ? "motion, magnified" : "deformation, magnified";
  $("frame").max = time.length - 1;
  slider("magnification", Math.log10(state.magnification), value => {
    state.magnification = 10 ** value;
    update({ deformed: false });
  });
  slider("frame", 0, value => { show(value); state.clock = time[state.frame] - time[0]; });
  slider("speed", Math.log10(state.speed), value => { state.speed = 10 ** value; draw(); });
  $("magnification-box").hidden = $("player").hidden = false;
}
$("play").addEventListener("click", () => play(!state.playing));
addEventListener("keydown", event => {
  if (event.code !== "Space" || !(modes.length || motion)) return;
  event.preventDefault();
  play(!state.playing);
});
// Without this handler, the release of the space bar would also press the button in focus.
addEventListener("keyup", event => { if (event.code === "Space") event.preventDefault(); });

// ---- names under the pointer

const pointer = new THREE.Vector2(), ray = new THREE.Raycaster();
function toScreen(place) {
  const p = place.clone().project(camera);
  return new THREE.Vector2((p.x + 1) / 2 * innerWidth, (1 - p.y) / 2 * innerHeight);
}

function distance(mark, at) {
  const lines = mark.segments.map(segment => segment.map(toScreen)).map(([a, b]) => {
    const along = b.clone().sub(a), share = along.lengthSq() ? at.clone().sub(a).dot(along) / along.lengthSq() : 0;
    return a.addScaledVector(along, Math.max(0, Math.min(1, share))).distanceTo(at) + 2;
  });
  return Math.min(...mark.places.map(place => toScreen(place).distanceTo(at)), ...lines);
}

function under(x, y) {
  const at = new THREE.Vector2(x, y);
  const close = marks.filter(mark => mark.object.visible && mark.places).map(mark => [distance(mark, at), mark])
    .filter(([far]) => far < 8).sort((a, b) => a[0] - b[0]).slice(0, 4);
  if (close.length) return close.map(([, mark]) => `${mark.kind} ${mark.name}\n${mark.text}`).join("\n");
  pointer.set(x / innerWidth * 2 - 1, 1 - y / innerHeight * 2);
  ray.setFromCamera(pointer, camera);
  const [hit] = ray.intersectObjects(meshes.filter(mesh => mesh.visible && mesh.userData.shape.group.visible), false);
  if (!hit) return "";
  const { shape, label } = hit.object.userData;
  const length = displacement(shape, hit.face.a).length();
  const moved = modes.length ? length / modes[state.mode].peak * state.amplitude * size : length;
  return [shape.name, label === shape.name ? "" : label, shape.text, moves ? `displacement ${text(moved)}` : ""]
    .filter(Boolean).join("\n");
}

renderer.domElement.addEventListener("pointermove", event => {
  const found = event.buttons ? "" : under(event.clientX, event.clientY);
  const left = `${Math.min(event.clientX + 14, innerWidth - 200)}px`, top = `${event.clientY + 14}px`;
  Object.assign($("tip").style, { display: found ? "block" : "none", left, top });
  $("tip").textContent = found;
});
renderer.domElement.addEventListener("pointerleave", () => { $("tip").style.display = "none"; });

// ---- start

$("title").textContent = header.title;
$("bar").style.background = `linear-gradient(to top, ${COLORS.map(color => `#${color.getHexString()}`).join(", ")})`;
addEventListener("resize", () => { resize(); draw(); });
withPalette(palette => {
  for (const [kind, material] of Object.entries(LINES)) material.color.set(palette[kind]);
  draw();
});
resize();
look("iso");
recolor();

// Interface for programs that read the displayed values: [x, y, z] in metres along the world's axes.
window.nassim = { header, state, shapes, marks, ready: true, under,
  displacement: (name, index) => displacement(named[name], index).toArray(),
  drawn: (name, index) => drawnAt({ shape: named[name], index }).toArray(),
  toScreen: place => toScreen(new THREE.Vector3(...place)).toArray() };
