// What buttons, keys, mouse and fingers do.
function refresh() {
  element("a").value = state.a;
  element("b").value = state.b;
  element("show").value = state.show;
  element("wipe").value = state.wipe;
  element("photo").value = camera.exact && card.photos.length ? camera.like : "";
  for (const name of ["fly", "frusta"]) element(name).setAttribute("aria-pressed", state[name]);
  element("record").setAttribute("aria-pressed", Boolean(recorded));
  draw();
}
const set = (changes) => {
  Object.assign(state, changes);
  refresh();
};
const asking = (changes) => {
  set(changes);
  ask(false);
};
const step = (by) => card.photos.length && go((camera.like + (camera.exact ? by : 0) + card.photos.length) % card.photos.length);
const toggle = (name) => set({ [name]: !state[name] });
const SHOWS = ["color", "depth", "opacity", "normals"];

card.fields.forEach((name, i) => {
  element("a").append(new Option(name, i));
  element("b").append(new Option(name, i));
});
element("b").append(new Option("nothing", "none"));
if (card.photos.length) element("b").append(new Option("photo", "photo"));
element("photo").append(new Option("none", ""));
card.photos.forEach((name, i) => element("photo").append(new Option(name, i)));
element("a").addEventListener("change", (event) => asking({ a: Number(event.target.value) }));
element("b").addEventListener("change", (event) => asking({ b: event.target.value }));
element("show").addEventListener("change", (event) => asking({ show: event.target.value }));
element("photo").addEventListener("change", (event) => event.target.value && go(Number(event.target.value)));
element("size").addEventListener("change", () => ask(false));
element("wipe").addEventListener("input", (event) => set({ wipe: Number(event.target.value) }));
element("frusta").addEventListener("click", () => toggle("frusta"));
element("fly").addEventListener("click", () => toggle("fly"));
element("reset").addEventListener("click", () => go(0));
element("copy").addEventListener("click", copy);
element("record").addEventListener("click", record);

const FLYING = { w: [0, 0, -1], s: [0, 0, 1], a: [-1, 0, 0], d: [1, 0, 0], q: [0, -1, 0], e: [0, 1, 0] };
const TURNING = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const held = new Set();
let before = 0;
function fly(now) {
  const seconds = Math.min(0.1, (now - before) / 1000);
  before = now;
  for (const key of held) {
    if (FLYING[key]) shift(...scaled(FLYING[key], 0.5 * seconds * Math.max(distance(), card.cameras[camera.like].near)));
    else orbit(...scaled(TURNING[key], seconds));
  }
  if (held.size) requestAnimationFrame(fly);
}
const actions = {
  v: () => toggle("frusta"), f: () => toggle("fly"), c: copy, r: record, "0": () => go(0),
  "[": () => step(-1), "]": () => step(1), " ": () => set({ all: true }),
};
SHOWS.forEach((show, i) => { actions[i + 1] = () => asking({ show }); });
document.addEventListener("keydown", (event) => {
  if (event.target.closest("select, input") || event.ctrlKey || event.metaKey || event.altKey) return;
  const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
  if (key === " " && event.target.closest("button")) return;
  if (FLYING[key] || TURNING[key]) {
    if (!held.size) requestAnimationFrame((now) => { before = now; fly(now); });
    held.add(key);
  } else if (!actions[key]) return;
  else if (!event.repeat) actions[key]();
  event.preventDefault();
});
document.addEventListener("keyup", (event) => {
  held.delete(event.key.length === 1 ? event.key.toLowerCase() : event.key);
  if (event.key === " ") set({ all: false });
});
addEventListener("blur", () => held.clear());

const pointers = new Map();
let dragging = "";
let far = 0;
main.addEventListener("pointerdown", (event) => {
  main.setPointerCapture(event.pointerId);
  main.focus({ preventScroll: true });
  pointers.set(event.pointerId, event);
  far = pointers.size > 1 ? Infinity : 0;
  const box = main.getBoundingClientRect();
  const near = Math.abs(event.clientX - box.left - state.wipe * box.width) < 14;
  dragging = near && state.b !== "none" && pointers.size === 1 ? "wipe" : "camera";
});
main.addEventListener("pointermove", (event) => {
  const last = pointers.get(event.pointerId);
  if (!last) return;
  const box = main.getBoundingClientRect();
  const across = (event.clientX - last.clientX) / box.width;
  const down = (event.clientY - last.clientY) / box.width;
  far += Math.hypot(event.clientX - last.clientX, event.clientY - last.clientY);
  if (dragging === "wipe") set({ wipe: Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)) });
  else if (far < 4) return;
  else drag(event, last, across, down);
  pointers.set(event.pointerId, event);
});
function drag(event, last, across, down) {
  const lens = card.cameras[camera.like];
  const wide = distance() * lens.w / lens.fl_x;
  if (pointers.size === 2) {
    const [other] = [...pointers.entries()].filter(([id]) => id !== event.pointerId).map(([, pointer]) => pointer);
    const apart = (pointer) => Math.max(1, Math.hypot(pointer.clientX - other.clientX, pointer.clientY - other.clientY));
    shift(-0.5 * wide * across, 0.5 * wide * down, 0);
    approach(apart(last) / apart(event));
  } else if (event.shiftKey || event.buttons & 6) shift(-wide * across, wide * down, 0);
  else orbit(3 * across, 3 * down);
}
main.addEventListener("pointerup", (event) => {
  const found = far < 4 && state.frusta ? cameraAt(event) : null;
  if (found !== null) go(found);
});
for (const end of ["pointerup", "pointercancel"]) {
  main.addEventListener(end, (event) => pointers.delete(event.pointerId));
}
main.addEventListener("contextmenu", (event) => event.preventDefault());
main.addEventListener("wheel", (event) => {
  event.preventDefault();
  const pixels = event.deltaMode === 1 ? 30 * event.deltaY : event.deltaY;
  if (state.fly) shift(0, 0, 0.001 * pixels * distance());
  else approach(1.001 ** pixels);
}, { passive: false });
addEventListener("resize", () => ask(false));

main.style.setProperty("--ratio", card.cameras[0].w / card.cameras[0].h);
ask(false);
