// The image wall. Without it the table, the thumbnails and the crops remain.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const element = (id) => document.getElementById(id);
  if (!data.views.length || !data.arms.length) return;

  // An arm whose stages have not run has no pictures.
  const seen = data.arms.map((arm, number) => number).filter((number) => data.arms[number].renders.some(Boolean));
  if (!seen.length) return;
  const first = seen.find((number) => data.arms[number].name === data.baseline) ?? seen[0];
  const other = seen.find((number) => number !== first) ?? first;
  const state = {
    view: 0, a: first, b: other, mode: "image",
    exposure: 0, zoom: 1, x: 0.5, y: 0.5, wipe: 0.5,
  };

  // Pictures lie in the style sheet, each once; here each is decoded when it is first shown.
  const pictures = new Map();
  function picture(name) {
    if (!name) return null;
    if (!pictures.has(name)) {
      const probe = document.createElement("div");
      probe.className = name;
      probe.style.display = "none";
      document.body.append(probe);
      const url = getComputedStyle(probe).backgroundImage.slice(5, -2);
      probe.remove();
      const entry = { pixels: null };
      pictures.set(name, entry);
      const image = new Image();
      image.onload = () => {
        const canvas = document.createElement("canvas");
        canvas.width = image.naturalWidth;
        canvas.height = image.naturalHeight;
        const context = canvas.getContext("2d", { willReadFrequently: true });
        context.drawImage(image, 0, 0);
        entry.pixels = context.getImageData(0, 0, canvas.width, canvas.height);
        draw();
      };
      image.src = url;
    }
    return pictures.get(name).pixels;
  }

  const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
  const encoded = (v) => (v <= 0.0031308 ? v * 12.92 : 1.055 * v ** (1 / 2.4) - 0.055);
  // Exposure is in stops of light, so it is computed on linear values.
  function table() {
    const gain = 2 ** state.exposure;
    return Uint8ClampedArray.from({ length: 256 }, (_, v) => 255 * encoded(Math.min(1, gain * linear(v / 255))));
  }

  // What is shown of an arm: a canvas of the picture's own size, kept until something changes.
  const shown = new Map();
  function content(arm) {
    const view = data.views[state.view];
    const own = data.arms[arm];
    const key = [arm, state.view, state.mode, state.exposure].join();
    if (shown.has(key)) return shown.get(key);
    const name = state.mode === "reference" ? view.photo
      : state.mode === "flip" ? own.errors[state.view] : own.renders[state.view];
    const pixels = picture(name);
    const photo = picture(view.photo);
    if (!pixels || (state.mode === "difference" && !photo)) return null;
    const canvas = document.createElement("canvas");
    canvas.width = pixels.width;
    canvas.height = pixels.height;
    const context = canvas.getContext("2d");
    const result = context.createImageData(pixels.width, pixels.height);
    const lookup = state.mode === "flip" ? null : table();
    for (let at = 0; at < pixels.data.length; at += 1) {
      let value = pixels.data[at];
      if (at % 4 < 3) {
        if (state.mode === "difference") value = Math.min(255, 4 * Math.abs(value - photo.data[at]));
        if (lookup) value = lookup[value];
      }
      result.data[at] = value;
    }
    context.putImageData(result, 0, 0);
    if (shown.size > 200) shown.clear();
    shown.set(key, canvas);
    return canvas;
  }

  // The part of a picture that is seen, in its pixels.
  function window_(source) {
    const width = source.width / state.zoom;
    const height = source.height / state.zoom;
    const left = state.x * source.width - width / 2;
    const top = state.y * source.height - height / 2;
    return { left, top, width, height };
  }

  function paint(canvas, source) {
    const context = canvas.getContext("2d");
    context.clearRect(0, 0, canvas.width, canvas.height);
    if (!source) return;
    const part = window_(source);
    context.imageSmoothingEnabled = canvas.width / part.width < 3;
    context.drawImage(source, part.left, part.top, part.width, part.height, 0, 0, canvas.width, canvas.height);
  }

  function fit(canvas, source) {
    const width = Math.max(1, Math.round(canvas.clientWidth * Math.min(2, devicePixelRatio || 1)));
    const height = Math.round(width * source.height / source.width);
    if (canvas.width !== width || canvas.height !== height) {
      canvas.width = width;
      canvas.height = height;
    }
  }

  const main = element("main");
  const grid = element("grid");
  const cells = data.arms.map((arm, number) => {
    const cell = document.createElement("button");
    cell.type = "button";
    cell.className = "cell";
    cell.disabled = !seen.includes(number);
    const canvas = document.createElement("canvas");
    const caption = document.createElement("span");
    cell.append(canvas, caption);
    cell.addEventListener("click", (event) => set(event.shiftKey ? { b: number } : { a: number }));
    grid.append(cell);
    return { cell, canvas, caption };
  });

  let waiting = false;
  function draw() {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => {
      waiting = false;
      const a = content(state.a);
      const b = content(state.b);
      if (!a) main.getContext("2d").clearRect(0, 0, main.width, main.height);
      if (a) {
        main.style.setProperty("--ratio", a.width / a.height);
        fit(main, a);
        paint(main, a);
        if (b && state.a !== state.b) wipe(b);
      }
      cells.forEach(({ canvas }, number) => {
        const source = seen.includes(number) && content(number);
        if (source) {
          fit(canvas, source);
          paint(canvas, source);
        }
      });
    });
  }

  function wipe(source) {
    const context = main.getContext("2d");
    const at = state.wipe * main.width;
    const part = window_(source);
    context.save();
    context.beginPath();
    context.rect(at, 0, main.width - at, main.height);
    context.clip();
    context.clearRect(0, 0, main.width, main.height);
    context.drawImage(source, part.left, part.top, part.width, part.height, 0, 0, main.width, main.height);
    context.restore();
    context.fillStyle = "#fff";
    context.fillRect(at - 1, 0, 2, main.height);
    const size = Math.max(11, main.width / 60);
    context.font = `${size}px system-ui, sans-serif`;
    context.shadowColor = "#000";
    context.shadowBlur = 4;
    context.fillText(data.arms[state.a].name, 8, main.height - 8);
    context.textAlign = "right";
    context.fillText(data.arms[state.b].name, main.width - 8, main.height - 8);
    context.textAlign = "left";
    context.shadowBlur = 0;
  }

  function set(changes) {
    Object.assign(state, changes);
    state.zoom = Math.min(64, Math.max(1, state.zoom));
    const margin = 0.5 / state.zoom;
    state.x = Math.min(1 - margin, Math.max(margin, state.x));
    state.y = Math.min(1 - margin, Math.max(margin, state.y));
    element("view").value = state.view;
    element("a").value = state.a;
    element("b").value = state.b;
    element("exposure").value = state.exposure;
    element("wipe").value = state.wipe;
    for (const mode of ["reference", "difference", "flip"]) {
      element(mode).setAttribute("aria-pressed", state.mode === mode);
    }
    cells.forEach(({ cell, caption }, number) => {
      cell.classList.toggle("a", number === state.a);
      cell.classList.toggle("b", number === state.b);
      caption.textContent = `${number < 9 ? `${number + 1} ` : ""}${data.arms[number].captions[state.view]}`;
    });
    draw();
  }

  const toggle = (mode) => set({ mode: state.mode === mode ? "image" : mode });
  const step = (by) => set({ view: (state.view + by + data.views.length) % data.views.length });

  function choices(id, names, of) {
    const select = element(id);
    names.forEach((name, number) => select.append(new Option(name, number)));
    select.addEventListener("change", () => set({ [of]: Number(select.value) }));
  }
  choices("view", data.views.map((view) => view.name), "view");
  choices("a", data.arms.map((arm) => arm.name), "a");
  choices("b", data.arms.map((arm) => arm.name), "b");
  for (const id of ["a", "b"]) {
    [...element(id).options].forEach((option, number) => { option.disabled = !seen.includes(number); });
  }
  for (const mode of ["reference", "difference", "flip"]) {
    element(mode).addEventListener("click", () => toggle(mode));
  }
  element("exposure").addEventListener("input", (event) => set({ exposure: Number(event.target.value) }));
  element("wipe").addEventListener("input", (event) => set({ wipe: Number(event.target.value) }));
  element("closer").addEventListener("click", () => set({ zoom: state.zoom * 1.5 }));
  element("farther").addEventListener("click", () => set({ zoom: state.zoom / 1.5 }));
  const reset = () => set({ zoom: 1, x: 0.5, y: 0.5, exposure: 0, mode: "image", wipe: 0.5 });
  element("reset").addEventListener("click", reset);

  document.addEventListener("keydown", (event) => {
    const typing = event.target.closest("select, input, textarea");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    const number = Number(event.key);
    const actions = {
      r: () => toggle("reference"), d: () => toggle("difference"), f: () => toggle("flip"),
      "0": reset, "+": () => set({ zoom: state.zoom * 1.5 }), "=": () => set({ zoom: state.zoom * 1.5 }),
      "-": () => set({ zoom: state.zoom / 1.5 }), "[": () => set({ exposure: Math.max(-3, state.exposure - 0.25) }),
      "]": () => set({ exposure: Math.min(3, state.exposure + 0.25) }),
      ArrowLeft: () => step(-1), ArrowRight: () => step(1),
    };
    const action = number >= 1 && number <= 9 && seen.includes(number - 1)
      ? () => set({ a: number - 1 }) : actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action) {
      action();
      event.preventDefault();
    }
  });

  // Where a pointer is, in the picture's own range.
  function spot(event) {
    const box = main.getBoundingClientRect();
    const across = (event.clientX - box.left) / box.width;
    const down = (event.clientY - box.top) / box.height;
    return { across, x: state.x + (across - 0.5) / state.zoom, y: state.y + (down - 0.5) / state.zoom };
  }

  function tell(event) {
    const { x, y } = spot(event);
    const line = (label, pixels) => {
      if (!pixels) return "";
      const at = Math.floor(x * pixels.width);
      const row = Math.floor(y * pixels.height);
      if (at < 0 || row < 0 || at >= pixels.width || row >= pixels.height) return "";
      const from = 4 * (row * pixels.width + at);
      return `${label} ${at},${row}: ${[...pixels.data.slice(from, from + 3)].join(" ")}`;
    };
    const of = (arm) => picture(data.arms[arm].renders[state.view]);
    element("readout").textContent = [
      line(`A ${data.arms[state.a].name}`, of(state.a)), line(`B ${data.arms[state.b].name}`, of(state.b)),
      line("photo", picture(data.views[state.view].photo)),
    ].filter(Boolean).join("  |  ");
  }

  const pointers = new Map();
  let dragging = "";
  main.addEventListener("pointerdown", (event) => {
    main.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    const near = Math.abs(spot(event).across - state.wipe) * main.clientWidth < 14;
    dragging = near && state.a !== state.b && pointers.size === 1 ? "wipe" : "move";
  });
  main.addEventListener("pointermove", (event) => {
    tell(event);
    const before = pointers.get(event.pointerId);
    if (!before) return;
    if (dragging === "wipe") {
      set({ wipe: Math.min(1, Math.max(0, spot(event).across)) });
    } else {
      const box = main.getBoundingClientRect();
      const share = 1 / (pointers.size * state.zoom);
      const moved = {
        x: state.x - share * (event.clientX - before.clientX) / box.width,
        y: state.y - share * (event.clientY - before.clientY) / box.height,
      };
      if (pointers.size === 2) {
        const [other] = [...pointers.entries()].filter(([id]) => id !== event.pointerId).map(([, held]) => held);
        const apart = (held) => Math.hypot(held.clientX - other.clientX, held.clientY - other.clientY);
        moved.zoom = state.zoom * apart(event) / Math.max(1, apart(before));
      }
      set(moved);
    }
    pointers.set(event.pointerId, event);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    main.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  main.addEventListener("wheel", (event) => {
    event.preventDefault();
    const { x, y } = spot(event);
    const zoom = Math.min(64, Math.max(1, state.zoom * 1.0015 ** -event.deltaY));
    // What is under the pointer stays there.
    const kept = state.zoom / zoom;
    set({ zoom, x: x + (state.x - x) * kept, y: y + (state.y - y) * kept });
  }, { passive: false });
  addEventListener("resize", draw);

  element("viewer").hidden = false;
  element("thumbs").hidden = true;
  set({});
})();
