// Asks the server for pictures. On its way the camera asks for one after the other; once it stands, for finer and finer
// ones. Knows nothing of how they are shown.
let number = 0;
let underway = "";
let again = "";
const shown = { pictures: [], head: null };
const times = { begun: 0, frames: [] };

// The screen's own pixels that the picture covers, within reason.
const covered = () => Math.min(1600, Math.round(main.clientWidth * Math.min(2, devicePixelRatio || 1)));
const size = () => {
  const { w, h } = card.cameras[camera.like];
  const wide = Number(element("size").value) || covered();
  return [Math.max(8, wide), Math.max(1, Math.round(wide * h / w))];
};
const panes = () => [state.a, ...(isField(state.b) ? [Number(state.b)] : [])].map((field) => ({ field, show: state.show }));
const isField = (choice) => choice !== "none" && choice !== "photo";

function ask(moving) {
  refresh();
  if (underway === "moving") again = moving ? "moving" : again || "still";
  else run(moving);
}
async function run(moving) {
  const mine = ++number;
  underway = moving ? "moving" : "still";
  again = "";
  document.body.dataset.fine = "";
  if (!moving) times.begun = performance.now();
  try {
    const body = JSON.stringify({ stand: stand(), width: size()[0], panes: panes(), moving });
    const answer = await fetch("look", { method: "POST", body });
    if (!answer.ok) throw new Error(await answer.text());
    await read(answer.body.getReader(), mine, panes().length);
  } catch (error) {
    if (mine === number) say(`No picture: ${error.message}. Does the server still run?`);
  }
  if (mine !== number) return;
  underway = "";
  if (again) run(again === "moving");
  else if (moving) run(false);
}

// Frames lie one behind the other: a line of JSON, then the bytes of a picture. Those of an older camera are read to
// their end, so that the connection serves again, but not shown.
async function read(reader, mine, count) {
  let bytes = new Uint8Array(0);
  let pictures = [];
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    if (mine !== number) continue;
    const longer = new Uint8Array(bytes.length + value.length);
    longer.set(bytes);
    longer.set(value, bytes.length);
    bytes = longer;
    for (let end = bytes.indexOf(10); end >= 0; end = bytes.indexOf(10)) {
      const head = JSON.parse(new TextDecoder().decode(bytes.subarray(0, end)));
      if (bytes.length < end + 1 + head.bytes) break;
      const file = new Blob([bytes.slice(end + 1, end + 1 + head.bytes)], { type: head.type });
      bytes = bytes.slice(end + 1 + head.bytes);
      pictures.push(await createImageBitmap(file));
      if (mine !== number) break;
      // Both sides of the line change together.
      if (pictures.length === count) {
        Object.assign(shown, { pictures, head });
        pictures = [];
        tell(head);
        draw();
      }
    }
  }
}

function tell(head) {
  const now = performance.now();
  times.frames = [...times.frames.filter((time) => now - time < 1000), now];
  const rate = underway === "moving" ? `${times.frames.length} pictures in the last second` : `after ${((now - times.begun) / 1000).toFixed(2)} s`;
  const fine = head.rays > 1 ? `${head.rays * head.rays} rays a pixel` : `1/${head.part}`;
  document.body.dataset.fine = `1/${head.part}x${head.rays}`;
  const photo = camera.exact && card.photos.length ? `at ${card.photos[camera.like]}` : "";
  say([`${head.width}x${head.height}`, fine, rate, photo, recorded ? `${recorded.length} places recorded` : ""].filter(Boolean).join("  |  "));
}
const say = (text) => { element("readout").textContent = text; };
