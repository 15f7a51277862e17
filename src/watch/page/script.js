const $ = id => document.getElementById(id);
let names = [];
const cards = {};
const begun = {};
const shown = new Set();

function element(kind, text, name) {
  const made = document.createElement(kind);
  if (text !== undefined) made.textContent = text;
  if (name) made.className = name;
  return made;
}

function figure(value) {
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(2) : String(Number(value.toPrecision(4)));
}

function time(seconds) {
  if (seconds < 10) return seconds.toFixed(1) + " s";
  if (seconds < 60) return Math.round(seconds) + " s";
  return Math.floor(seconds / 60) + " min " + String(Math.round(seconds) % 60).padStart(2, "0") + " s";
}

function latest(card) {
  return Object.entries(card.curves).map(([name, points]) => name + " " + figure(points[points.length - 1][1])).join("  ");
}

// A curve of steps and values, as wide as its box.
function curve(name, points) {
  const box = element("div", undefined, "curve");
  const values = points.map(point => point[1]).filter(Number.isFinite);
  const low = Math.min(...values), high = Math.max(...values);
  const first = points[0][0], last = points[points.length - 1][0];
  const place = ([step, value]) =>
    `${(100 * (step - first) / Math.max(1, last - first)).toFixed(2)},${(48 - 46 * (value - low) / (high - low || 1)).toFixed(2)}`;
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  svg.setAttribute("viewBox", "0 0 100 50");
  svg.setAttribute("preserveAspectRatio", "none");
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", `${name} from ${figure(low)} to ${figure(high)}`);
  const line = document.createElementNS(space, "polyline");
  line.setAttribute("points", points.filter(point => Number.isFinite(point[1])).map(place).join(" "));
  svg.append(line);
  box.append(svg, element("p", `${name}: ${figure(low)} to ${figure(high)}, now ${figure(points[points.length - 1][1])}`));
  return box;
}

function drawRunning() {
  const running = names.filter(name => cards[name].state === "running");
  $("now").replaceChildren(...running.map(name => {
    const card = cards[name];
    const box = element("article", undefined, "running");
    box.append(element("h3", name));
    const rest = card.total ? `step ${card.step} of ${card.total}` : "running";
    box.append(element("p", `${rest}, ${time((Date.now() - begun[name]) / 1000)}`));
    const bar = element("progress");
    bar.max = card.total || 1;
    if (card.total) bar.value = card.step;
    bar.setAttribute("aria-label", name);
    box.append(bar);
    for (const [figureName, points] of Object.entries(card.curves)) if (points.length > 1) box.append(curve(figureName, points));
    return box;
  }));
}

function row(name) {
  const card = cards[name];
  const line = element("tr", undefined, card.state);
  const why = [card.why, ...card.warnings].filter(Boolean).join("; ");
  const texts = [name, card.state, card.seconds === null ? "" : time(card.seconds), latest(card), why];
  line.append(...texts.map(text => element("td", text)));
  line.dataset.stage = name;
  return line;
}

function drawTable(changed) {
  const body = document.querySelector("#stages tbody");
  if (!changed) return body.replaceChildren(...names.map(row));
  for (const name of changed) body.children[names.indexOf(name)].replaceWith(row(name));
}

function drawSummary() {
  const count = state => names.filter(name => cards[name].state === state).length;
  const over = count("done") + count("cached");
  const parts = [`${over} of ${names.length} stages are done`, `${count("cached")} of them were cached`];
  for (const state of ["running", "failed", "blocked", "stopped"]) if (count(state)) parts.push(`${count(state)} ${state}`);
  $("summary").textContent = parts.join(", ") + "." + ($("summary").dataset.ended ? " " + $("summary").dataset.ended : "");
  $("whole").max = Math.max(1, names.length);
  $("whole").value = over;
}

function open(url, text) {
  $("large").src = url;
  $("large").alt = text;
  $("caption").textContent = text;
  $("full").showModal();
}

async function showPictures(name) {
  if (shown.has(name)) return;
  shown.add(name);
  const answer = await fetch("pictures/" + encodeURIComponent(name));
  const listed = answer.ok ? await answer.json() : [];
  if (!listed.length) return;
  const part = element("section");
  part.dataset.stage = name;
  part.append(element("h3", name));
  const strip = element("div", undefined, "strip");
  for (const { output, file } of listed) {
    const url = ["pictures", name, output, file].map(encodeURIComponent).join("/");
    const text = `${output} ${file.replace(/\.\w+$/, "")}`;
    const button = element("button");
    button.type = "button";
    const image = element("img");
    image.loading = "lazy";
    image.alt = `${name}: ${text}`;
    image.src = url;
    button.append(image, text);
    button.onclick = () => open(url, `${name}: ${text}`);
    strip.append(button);
  }
  part.append(strip);
  // In the order of the pipeline, the last first, however the answers come.
  const at = names.indexOf(name);
  const after = [...$("pictures").children].find(other => names.indexOf(other.dataset.stage) < at);
  $("pictures").insertBefore(part, after || null);
}

function take(message) {
  if (message.names) {
    names = message.names;
    $("title").textContent = message.pipeline;
    document.title = message.pipeline + " – srnerf-dag run";
  }
  if (message.ended) $("summary").dataset.ended = message.ended;
  const changed = Object.keys(message.stages || {});
  for (const name of changed) {
    cards[name] = message.stages[name];
    if (cards[name].state === "running") begun[name] ??= Date.now();
    if (["done", "cached"].includes(cards[name].state)) showPictures(name);
  }
  drawTable(message.names ? undefined : changed);
  drawSummary();
  drawRunning();
}

const changes = new EventSource("changes");
changes.onmessage = event => take(JSON.parse(event.data));
changes.onerror = () => {
  if ($("summary").dataset.ended) changes.close();
  else $("summary").textContent = "The run does not answer: it has ended, or was stopped.";
};
// Times of what runs go on between two messages.
setInterval(() => { if (names.length) drawRunning(); }, 1000);
