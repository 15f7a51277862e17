// Draws the pictures, the line between them and the photos' cameras. Asks for nothing but photos.
const main = element("main");
const context = main.getContext("2d");

const photos = new Map();
function photo() {
  if (!camera.exact || !card.photos.length) return null;
  const at = camera.like;
  if (!photos.has(at)) {
    photos.set(at, null);
    fetch(`photo/${at}`).then((answer) => answer.blob()).then(createImageBitmap)
      .then((bitmap) => { photos.set(at, bitmap); draw(); }).catch(() => photos.delete(at));
  }
  return photos.get(at);
}

let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    const [wide, high] = size();
    // Lines and labels are sharp on small pictures, too.
    const width = Math.max(wide, covered());
    const height = Math.round(width * high / wide);
    if (main.width !== width || main.height !== height) {
      main.width = width;
      main.height = height;
      main.style.setProperty("--ratio", width / height);
    }
    paint(shown.pictures[0], 0, true);
    const other = state.b === "photo" ? photo() : isField(state.b) ? shown.pictures[1] : null;
    if (other) compare(other);
    if (state.frusta) frusta();
  });
}
// The photo is shown by its own pixels.
function paint(picture, from, smooth) {
  if (!picture) return;
  context.save();
  context.beginPath();
  context.rect(from, 0, main.width - from, main.height);
  context.clip();
  context.imageSmoothingEnabled = smooth;
  context.drawImage(picture, 0, 0, main.width, main.height);
  context.restore();
}
function compare(picture) {
  const at = state.all ? 0 : state.wipe * main.width;
  paint(picture, at, state.b !== "photo");
  const label = Math.max(11, main.width / 60);
  context.save();
  context.fillStyle = "#fff";
  if (!state.all) context.fillRect(at - 1, 0, 2, main.height);
  context.font = `${label}px system-ui, sans-serif`;
  context.shadowColor = "#000";
  context.shadowBlur = 4;
  if (!state.all) context.fillText(card.fields[state.a], 8, main.height - 8);
  context.textAlign = "right";
  context.fillText(state.b === "photo" ? "photo" : card.fields[state.b], main.width - 8, main.height - 8);
  context.restore();
}

// Where a point is in the picture, as a pinhole sees it; nothing behind the camera.
function projected(point) {
  const lens = card.cameras[camera.like];
  const from = add(point, camera.position, -1);
  const depth = -dot(from, camera.back);
  if (depth < 0.01 * lens.near) return null;
  const x = lens.cx + lens.fl_x * dot(from, camera.right) / depth;
  const y = lens.cy - lens.fl_y * dot(from, camera.up) / depth;
  return [x * main.width / lens.w, y * main.height / lens.h];
}
const apex = (number) => column(card.cameras[number].pose, 3);
function rim(number) {
  const { w, h, fl_x, fl_y, cx, cy, pose } = card.cameras[number];
  const ahead = 0.08 * Math.hypot(...add(apex(number), card.focus, -1));
  return [[0, 0], [w, 0], [w, h], [0, h]].map(([x, y]) => {
    const local = [ahead * (x - cx) / fl_x, -ahead * (y - cy) / fl_y, -ahead];
    return pose.map((row) => dot(row, local) + row[3]);
  });
}
function frusta() {
  context.save();
  context.lineWidth = Math.max(1, main.width / 800);
  card.photos.forEach((_, number) => {
    if (camera.exact && number === camera.like) return;
    const corners = rim(number).map(projected);
    const point = projected(apex(number));
    if (!point || corners.includes(null)) return;
    context.strokeStyle = number === camera.like ? "#fc3" : "#4bf";
    context.beginPath();
    corners.forEach((corner, i) => {
      context.moveTo(...point);
      context.lineTo(...corner);
      context.lineTo(...corners[(i + 1) % 4]);
    });
    context.stroke();
  });
  context.restore();
}
// The camera that is seen at a place, nearest first.
function cameraAt(event) {
  const box = main.getBoundingClientRect();
  const spot = [(event.clientX - box.left) * main.width / box.width, (event.clientY - box.top) * main.height / box.height];
  const reach = 18 * main.width / box.width;
  const apart = (point) => point ? Math.hypot(point[0] - spot[0], point[1] - spot[1]) : Infinity;
  const near = card.photos.map((_, number) => [Math.min(...[apex(number), ...rim(number)].map(projected).map(apart)), number]);
  const [least, found] = near.sort((a, b) => a[0] - b[0])[0] ?? [Infinity, 0];
  return least <= reach ? found : null;
}
