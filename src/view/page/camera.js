// The camera: where it stands, which way its axes point, and what it turns around. Knows nothing of pictures.
const element = (id) => document.getElementById(id);
const card = JSON.parse(element("card").textContent);
const state = { a: 0, b: card.fields.length > 1 ? "1" : "none", show: "color", wipe: 0.5, all: false, fly: false, frusta: false };

const add = (a, b, k = 1) => a.map((x, i) => x + k * b[i]);
const scaled = (a, k) => a.map((x) => k * x);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scaled(a, 1 / Math.hypot(...a));
// Rodrigues' formula, about a unit axis.
const turned = (v, axis, angle) => {
  const along = scaled(axis, dot(axis, v) * (1 - Math.cos(angle)));
  return add(add(scaled(v, Math.cos(angle)), cross(axis, v), Math.sin(angle)), along);
};

const column = (pose, i) => pose.map((row) => row[i]);
const of = (number) => {
  const { pose } = card.cameras[number];
  const [right, up, back, position] = [0, 1, 2, 3].map((i) => column(pose, i));
  const ahead = Math.max(dot(add(position, card.focus, -1), back), card.cameras[number].near);
  return { like: number, exact: true, right, up, back, position, pivot: add(position, back, -ahead) };
};
let camera = of(0);

const matrix = () => [0, 1, 2].map((i) => [camera.right[i], camera.up[i], camera.back[i], camera.position[i]]);
const stand = () => camera.exact && card.photos.length ? { photo: camera.like } : { free: { like: camera.like, pose: matrix() } };
const distance = () => Math.hypot(...add(camera.position, camera.pivot, -1));

function moved(changes) {
  Object.assign(camera, changes, { exact: false });
  // Rounding must not bend the axes.
  camera.back = unit(camera.back);
  camera.right = unit(cross(camera.up, camera.back));
  camera.up = cross(camera.back, camera.right);
  ask(true);
}
function turn(axis, angle) {
  const about = (v) => turned(v, axis, angle);
  const axes = { right: about(camera.right), up: about(camera.up), back: about(camera.back) };
  const arm = about(add(camera.position, camera.pivot, -1));
  if (state.fly) moved({ ...axes, pivot: add(camera.position, axes.back, -distance()) });
  else moved({ ...axes, position: add(camera.pivot, arm) });
}
function orbit(across, down) {
  const way = state.fly ? 1 : -1;
  turn(unit(card.up), way * across);
  turn(camera.right, way * down);
}
function shift(right, up, back) {
  const by = add(add(scaled(camera.right, right), camera.up, up), camera.back, back);
  moved({ position: add(camera.position, by), pivot: add(camera.pivot, by) });
}
// Nearer to the pivot, never through it.
const approach = (factor) => moved({ position: add(camera.pivot, add(camera.position, camera.pivot, -1), factor) });
function go(number) {
  camera = of(number);
  ask(false);
}
