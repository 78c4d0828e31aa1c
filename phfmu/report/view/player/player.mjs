// Plays the motion of a run: window.MOTION as `phfmu/report/view/page.py` writes it. Bundled with three.js into player.js.
import * as THREE from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';

const MOTION = window.MOTION;
const { solids, lines, low, high, extent } = MOTION;

function floats(text) {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}

const poses = floats(MOTION.poses), ends = floats(MOTION.ends), tension = floats(MOTION.tension);
const time = floats(MOTION.time), frames = time.length, duration = time[frames - 1] - time[0];
const byId = id => document.getElementById(id);

// ---- the scene -----------------------------------------------------------------------------------------------------
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.shadowMap.enabled = true;
renderer.setPixelRatio(window.devicePixelRatio);
byId('stage').appendChild(renderer.domElement);

const scene = new THREE.Scene();
scene.background = new THREE.Color(0xf4f5f7);
const camera = new THREE.PerspectiveCamera(35, 1, extent / 200, extent * 100);
camera.up.set(0, 0, 1);
const controls = new OrbitControls(camera, renderer.domElement);

const middle = new THREE.Vector3(...low.map((v, i) => (v + high[i]) / 2));
scene.add(new THREE.HemisphereLight(0xffffff, 0x8899aa, 1.7));
const sun = new THREE.DirectionalLight(0xffffff, 2);
sun.position.copy(middle).add(new THREE.Vector3(extent, -1.5 * extent, 3 * extent));
sun.target.position.copy(middle);
sun.castShadow = true;
sun.shadow.mapSize.set(2048, 2048);
Object.assign(sun.shadow.camera, {
  left: -extent, right: extent, top: extent, bottom: -extent, near: extent / 10, far: 8 * extent,
});
scene.add(sun, sun.target);

const grid = new THREE.GridHelper(4 * extent, 40, 0xb4bdc7, 0xdbe0e6);
grid.rotation.x = Math.PI / 2;
grid.position.set(middle.x, middle.y, low[2] - 0.08 * extent);
const floor = new THREE.Mesh(new THREE.PlaneGeometry(4 * extent, 4 * extent), new THREE.ShadowMaterial({ opacity: 0.15 }));
floor.position.copy(grid.position);
floor.receiveShadow = true;
scene.add(grid, floor);

const COLOURS = [0x3b6ea8, 0xc8553d, 0x5b8c5a, 0x8a5a9e, 0xd19a2e, 0x4f9aa8];
const GREY = new THREE.Color(0x77808a), PULLED = new THREE.Color(0xc0392b), PUSHED = new THREE.Color(0x2471a3);

function coil(radius, length) {
  // of its length in the first frame, which is stretched in each frame
  const points = [], turns = Math.min(40, Math.max(6, Math.round(length / (2.2 * radius)))), n = 16 * turns;
  for (let i = 0; i <= n; i++) {
    const a = 2 * Math.PI * turns * i / n, r = Math.min(i, n - i) < 8 ? 0 : radius;
    points.push(new THREE.Vector3(r * Math.cos(a), r * Math.sin(a), (i / n - 0.5) * length));
  }
  return new THREE.TubeGeometry(new THREE.CatmullRomCurve3(points), 12 * turns, radius / 6, 5);
}

const geometry = {
  ball: s => new THREE.SphereGeometry(s[0], 32, 20),
  box: s => new THREE.BoxGeometry(s[0], s[1], s[2]),
  pin: s => new THREE.BoxGeometry(s[0], s[0], s[0]),
  cylinder: s => new THREE.CylinderGeometry(s[0], s[0], s[1], 40).rotateX(Math.PI / 2),
  rod: () => new THREE.CylinderGeometry(1, 1, 1, 16).rotateX(Math.PI / 2), // scaled to its length in each frame
};

function mesh(shape, colour, length) {
  const made = new THREE.Mesh(
    shape.kind === 'spring' ? coil(shape.size[0], length) : geometry[shape.kind](shape.size),
    new THREE.MeshStandardMaterial({ color: colour, roughness: 0.5, metalness: 0.1 }),
  );
  made.castShadow = made.receiveShadow = true;
  scene.add(made);
  return made;
}

let painted = 0;
const solidMeshes = solids.map(s => mesh(s, s.kind === 'pin' ? 0x555b62 : COLOURS[painted++ % COLOURS.length]));
const startLengths = lines.map((_, i) => Math.hypot(...[0, 1, 2].map(c => ends[6 * i + 3 + c] - ends[6 * i + c])) || 0.1 * extent);
const lineMeshes = lines.map((s, i) => mesh(s, 0x77808a, startLengths[i]));
const largest = tension.reduce((m, f) => (Number.isFinite(f) ? Math.max(m, Math.abs(f)) : m), 0);

// ---- trails: the path of each solid that moves, up to the time that is shown ---------------------------------------------
const trails = solids.map((shape, i) => {
  const points = new Float32Array(3 * frames);
  for (let k = 0; k < frames; k++) points.set(poses.subarray(7 * (k * solids.length + i), 7 * (k * solids.length + i) + 3), 3 * k);
  const path = new THREE.BufferGeometry().setAttribute('position', new THREE.BufferAttribute(points, 3));
  const line = new THREE.Line(path, new THREE.LineBasicMaterial({ color: solidMeshes[i].material.color }));
  line.visible = false;
  line.frustumCulled = false;
  scene.add(line);
  return line;
});

// ---- a frame -----------------------------------------------------------------------------------------------------------
const a = new THREE.Vector3(), b = new THREE.Vector3(), along = new THREE.Vector3();
const q0 = new THREE.Quaternion(), q1 = new THREE.Quaternion(), Z = new THREE.Vector3(0, 0, 1);

function at(array, width, count, k, i, part) {
  // value `part` of item i between frames: k = [whole, share]
  const here = width * (k[0] * count + i) + part, next = k[0] + 1 < frames ? here + width * count : here;
  return array[here] + k[1] * (array[next] - array[here]);
}

function place(now) {
  let low = 0, above = frames - 1; // the last frame at or before `now`
  while (above - low > 1) { const mid = (low + above) >> 1; if (time[mid] <= now) low = mid; else above = mid; }
  const whole = now >= time[frames - 1] ? frames - 1 : low;
  const width = whole + 1 < frames ? time[whole + 1] - time[whole] : 1;
  return [whole, width > 0 ? Math.min(1, Math.max(0, (now - time[whole]) / width)) : 0];
}

function pose(k) {
  const n = solids.length, m = lines.length;
  solidMeshes.forEach((made, i) => {
    made.position.set(at(poses, 7, n, k, i, 0), at(poses, 7, n, k, i, 1), at(poses, 7, n, k, i, 2));
    const here = 7 * (k[0] * n + i) + 3, next = k[0] + 1 < frames ? here + 7 * n : here;
    q0.fromArray(poses, here);
    q1.fromArray(poses, next);
    made.quaternion.slerpQuaternions(q0, q1, k[1]);
  });
  lineMeshes.forEach((made, i) => {
    a.set(at(ends, 6, m, k, i, 0), at(ends, 6, m, k, i, 1), at(ends, 6, m, k, i, 2));
    b.set(at(ends, 6, m, k, i, 3), at(ends, 6, m, k, i, 4), at(ends, 6, m, k, i, 5));
    along.subVectors(b, a);
    const length = Math.max(along.length(), 1e-9 * extent), radius = lines[i].size[0];
    made.position.addVectors(a, b).multiplyScalar(0.5);
    made.quaternion.setFromUnitVectors(Z, along.divideScalar(length));
    if (lines[i].kind === 'spring') made.scale.set(1, 1, length / startLengths[i]);
    else made.scale.set(radius, radius, length);
    const force = at(tension, 1, m, k, i, 0);
    const share = byId('forces').checked && Number.isFinite(force) && largest > 0 ? force / largest : 0;
    made.material.color.copy(GREY).lerp(share > 0 ? PULLED : PUSHED, Math.min(1, Math.abs(share) ** 0.5));
  });
  trails.forEach((line, i) => {
    line.visible = byId('trails').checked && solids[i].kind !== 'pin';
    line.geometry.setDrawRange(0, k[0] + 1);
  });
}

// ---- time ---------------------------------------------------------------------------------------------------------------
const asked = new URLSearchParams(location.hash.slice(1)).get('t');
let now = asked === null ? time[0] : Math.min(time[frames - 1], Math.max(time[0], Number(asked) || 0));
let running = asked === null && duration > 0, speed = 1, last = performance.now();

const speeds = byId('speed');
const natural = duration > 0 ? Math.min(1, Math.max(duration / 20, Math.min(1, duration / 5))) : 1;
for (const s of [...new Set([0.001, 0.01, 0.1, 0.25, 0.5, 1, 2, 5, 10])]) speeds.add(new Option(`${s} x`, s));
speed = [0.001, 0.01, 0.1, 0.25, 0.5, 1].filter(s => s <= natural * 1.0001).pop() ?? 0.001;
if (duration > 60) speed = duration > 200 ? 10 : 5;
speeds.value = speed;
speeds.onchange = () => { speed = Number(speeds.value); };

const slider = byId('time');
slider.min = time[0]; slider.max = time[frames - 1]; slider.step = 'any';
slider.oninput = () => { now = Number(slider.value); run(false); };
function run(on) { running = on; byId('play').textContent = on ? 'Pause' : 'Play'; }
byId('play').onclick = () => { if (!running && now >= time[frames - 1]) now = time[0]; run(!running); };
byId('reset').onclick = fit;
addEventListener('keydown', e => { if (e.key === ' ') { e.preventDefault(); byId('play').click(); } });
byId('forces').parentElement.hidden = !(largest > 0);
byId('scale').textContent = largest > 0 ? `largest ${largest.toPrecision(3)} N` : '';

// ---- camera: all of the motion in view, a plane from its front -------------------------------------------------------------
function fit() {
  const flat = high[1] - low[1] < 1e-6 * extent;
  const view = new THREE.Vector3(flat ? 0.15 : 0.9, -1.5, flat ? 0.15 : 0.55).normalize();
  const radius = 0.5 * Math.hypot(...high.map((v, i) => v - low[i])) || 0.5 * extent;
  const narrow = Math.min(1, camera.aspect) * Math.tan(camera.fov * Math.PI / 360);
  camera.position.copy(middle).addScaledVector(view, 1.12 * radius / Math.sin(Math.atan(narrow)));
  controls.target.copy(middle);
  controls.update();
}

function resize() {
  const { clientWidth: w, clientHeight: h } = byId('stage');
  renderer.setSize(w, h);
  camera.aspect = w / h;
  camera.updateProjectionMatrix();
}

function draw() {
  pose(place(now));
  slider.value = now;
  byId('clock').textContent = `${now.toFixed(MOTION.digits)} s`;
  renderer.render(scene, camera);
}

addEventListener('resize', () => { resize(); draw(); });
function loop(tick) {
  const passed = Math.min(0.25, (tick - last) / 1000);
  last = tick;
  if (running) { now += speed * passed; if (now > time[frames - 1]) now = time[0]; }
  controls.update();
  draw();
  requestAnimationFrame(loop);
}

resize();
fit();
run(running);
draw();
document.body.dataset.drawn = 'all';
requestAnimationFrame(loop);
