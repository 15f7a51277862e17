// Poses to take away: the camera's, and those of a path. Knows nothing of pictures.
let recorded = null;
let clock = 0;
// As many places a second as Film shows, from the first that differs to the last.
const RATE = 20;
const MOST = 10000;
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b);
function record() {
  if (!recorded) {
    recorded = [stand()];
    clock = setInterval(() => {
      if (recorded.length === 1 && same(recorded[0], stand())) return;
      recorded.push(stand());
      if (recorded.length === MOST) record();
    }, 1000 / RATE);
  } else {
    clearInterval(clock);
    const last = recorded.findLastIndex((place, i) => i === 0 || !same(place, recorded[i - 1]));
    save(recorded.slice(0, last + 1));
    recorded = null;
  }
  refresh();
}
async function save(stands) {
  try {
    const answer = await fetch("path", { method: "POST", body: JSON.stringify({ stands }) });
    if (!answer.ok) throw new Error(await answer.text());
    const link = document.createElement("a");
    link.href = URL.createObjectURL(await answer.blob());
    link.download = "transforms.json";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    say(`${stands.length} places saved as transforms.json: render them with Render(path: File(path: ..))`);
  } catch (error) {
    say(`The path is not saved: ${error.message}`);
  }
}
async function copy() {
  const pose = JSON.stringify([...matrix(), [0, 0, 0, 1]]);
  try {
    await navigator.clipboard.writeText(pose);
    say(`Copied, rows of camera to world: ${pose}`);
  } catch {
    say(`Rows of camera to world: ${pose}`);
  }
}
