"use strict";
// The page around meshcat's viewer: legend with check boxes, labels, time slider, plots.

const element = (id) => document.getElementById(id);
const viewer = new MeshCat.Viewer(element("scene"), true, hasWebGL() ? undefined : new FlatRenderer(element("scene")));
viewer.renderer.setPixelRatio(window.devicePixelRatio || 1);
const resize = viewer.set_3d_pane_size.bind(viewer);
viewer.set_3d_pane_size = () => {
  const w = element("scene").clientWidth, h = element("scene").clientHeight;
  const caption = element("caption").offsetWidth; // the scene moves out from under it
  const shift = Math.max(0, Math.min(0.5 * caption, 0.5 * (w - 1.45 * h)));
  viewer.camera.zoom = Math.min(1, w / h / CONFIG.aspect); // the camera was placed for that
  viewer.camera.setViewOffset(w, h, -shift, 0, w, h);
  resize(w, h);
};
viewer.gui.domElement.style.display = "none"; // meshcat's own controls: press g

const bytesOf = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)); // base64

async function unfold(text) { // base64 of zlib
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function drawAll(bytes) { // each command after its length
  const lengths = new DataView(bytes.buffer);
  for (let start = 0, end; start < bytes.length; start = end) {
    end = start + 4 + lengths.getUint32(start, true);
    viewer.handle_command_bytearray(bytes.slice(start + 4, end));
  }
}

function complain(error) {
  element("labels").textContent = `This page does not run in this browser: ${error}`;
  throw error;
}

// Only what changes is written: a page at rest then needs no new layout and no new picture.
const setText = (box, text) => { if (box.textContent !== text) box.textContent = text; };
const setStyle = (box, key, value) => { if (box.style[key] !== value) box.style[key] = value; };
const nodeAt = (path) => viewer.scene_tree.find(["meshcat", ...path.split("/").filter(Boolean)]);

const KEYS = {
  solid: (c) => `<rect y="3.2" width="17" height="3.6" fill="${c}"/><path d="M15 0l9 5-9 5z" fill="${c}"/>`,
  pale: (c) => `<g opacity=".32"><rect y="2" width="15" height="6" fill="${c}"/><path d="M13-2l11 7-11 7z" fill="${c}"/></g>`,
  thin: (c) => `<rect y="4.2" width="19" height="1.6" fill="${c}"/><path d="M17 1.8l7 3.2-7 3.2z" fill="${c}"/>`,
  line: (c) => `<rect y="4" width="24" height="2" fill="${c}"/>`,
  trail: (c) => `<path d="M1 8C8-4 15 14 23 2" fill="none" stroke="${c}" stroke-width="2" opacity=".7"/>`,
  turn: (c) => `<rect y="4.2" width="24" height="1.6" fill="${c}"/><path d="M14 1A5 4.4 0 1 0 15 8" fill="none" stroke="${c}" stroke-width="1.7"/>`,
};

function showLegend(entries) {
  const legend = element("legend");
  const names = legend.appendChild(document.createElement("div"));
  names.className = "names";
  for (const entry of entries.filter((e) => !e.paths.length)) {
    const name = names.appendChild(document.createElement("span"));
    name.appendChild(document.createElement("i")).style.background = entry.colour;
    name.appendChild(document.createElement("b")).textContent = entry.text;
  }
  for (const entry of entries.filter((e) => e.paths.length)) {
    const row = legend.appendChild(document.createElement("label"));
    const box = row.appendChild(document.createElement("input"));
    box.type = "checkbox";
    box.checked = true;
    box.name = entry.text;
    const key = row.appendChild(document.createElement("span"));
    key.className = "key";
    key.innerHTML = `<svg width="24" height="10" style="overflow:visible">${KEYS[entry.look](entry.colour)}</svg>`;
    row.appendChild(document.createElement("span")).textContent = entry.text;
    const apply = () => {
      for (const path of entry.paths) nodeAt(path).set_property("visible", box.checked);
      viewer.set_dirty();
    };
    box.addEventListener("change", apply);
    apply();
  }
}

// Places of a label, in its widths and heights from the first: the nearest ones come first.
const PLACES = [[0, 0], [0, -1], [0, 1], [-0.5, 0], [0.5, 0], [-0.5, -1], [0.5, -1], [0, -2], [0, 2],
  [-1, 0], [1, 0], [-1, -1], [1, -1], [-1, 1], [1, 1], [0, -3], [0, -4], [-1, -2], [1, -2], [0, -5], [0, -6]];

function showLabels(labels) {
  return labels.map((label) => {
    const box = element("labels").appendChild(document.createElement("div"));
    box.style.color = label.colour;
    return { ...label, box };
  });
}

function onScreen(object, pane) { // place (px) of a node's origin, and whether it is in the picture
  object.updateWorldMatrix(true, false);
  const at = new MeshCat.THREE.Vector3().setFromMatrixPosition(object.matrixWorld).project(viewer.camera);
  return {
    x: 0.5 * (at.x + 1) * pane.clientWidth, y: 0.5 * (1 - at.y) * pane.clientHeight,
    inside: Math.abs(at.x) < 1 && Math.abs(at.y) < 1 && at.z < 1,
  };
}

// Share of a box (x, y: its upper left corner) that an arrow from p to q crosses: 0, none of it.
function crossed(box, { p, q }) {
  let from = 0, to = 1;
  const sides = [[p.x, q.x - p.x, box.x, box.x + box.w], [p.y, q.y - p.y, box.y, box.y + box.h]];
  for (const [start, step, low, high] of sides) {
    if (Math.abs(step) < 1e-6) {
      if (start < low || start > high) return 0;
      continue;
    }
    const ends = [(low - start) / step, (high - start) / step].sort((u, v) => u - v);
    from = Math.max(from, ends[0]);
    to = Math.min(to, ends[1]);
  }
  return Math.max(0, to - from);
}

// A label stands beyond the tail of its arrow, or at the nearest place where it covers no other
// label and no arrow.
function placeLabels(labels, time) {
  const pane = element("scene"), shown = [], arrows = [], taken = [];
  for (const label of labels) {
    const { path, text, line, unit, lost, box } = label;
    const object = nodeAt(path).object;
    let seen = true;
    for (let above = object; above; above = above.parent) seen = seen && above.visible;
    const value = line === null ? null : plots.valueAt(line, time);
    const gone = lost && nodeAt(lost).object.visible;
    const reading = value === null ? "" : ` ${signed(value.toFixed(2))} ${unit}`;
    setText(box, text + (gone ? " lost" : reading));
    const tail = onScreen(object, pane);
    seen = seen && tail.inside;
    setStyle(box, "display", seen ? "" : "none");
    if (!seen) continue;
    const tip = onScreen(object.parent, pane);
    const end = { x: tip.x + 0.85 * (tail.x - tip.x), y: tip.y + 0.85 * (tail.y - tip.y) };
    if (line !== null) arrows.push({ p: tip, q: end }); // the label's node is some way beyond the arrow
    shown.push({ box, tail, tip, w: box.offsetWidth, h: box.offsetHeight });
  }
  for (const { box, tail, tip, w, h } of shown) {
    const length = Math.hypot(tail.x - tip.x, tail.y - tip.y);
    const [dx, dy] = length > 1 ? [(tail.x - tip.x) / length, (tail.y - tip.y) / length] : [0, -1];
    let best = null;
    for (const [i, j] of PLACES) {
      // beyond the tail, where the box just does not reach back to it; then i widths, j heights off
      const x = Math.min(pane.clientWidth - w - 4, Math.max(4, tail.x + (dx / 2 + i) * w - w / 2));
      const y = Math.min(pane.clientHeight - h - 4, Math.max(4, tail.y + (dy / 2 + j) * (h + 2) - h / 2));
      const place = { x, y, w, h };
      const over = taken.some((o) => x < o.x + o.w && o.x < x + w && Math.abs(y - o.y) < h + 2);
      const cost = (over ? 100 : 0) + arrows.reduce((sum, arrow) => sum + crossed(place, arrow), 0);
      if (best === null || cost < best.cost - 1e-3) best = { cost, place };
      if (best.cost === 0) break;
    }
    taken.push(best.place);
    setStyle(box, "transform", `translate(${Math.round(best.place.x)}px, ${Math.round(best.place.y)}px)`);
  }
}

function lookThrough(camera) { // the controls turn about the origin: what is looked at goes there
  const [x, y, z] = camera.offset;
  nodeAt("").object.position.set(...camera.target.map((value) => -value));
  viewer.camera.position.set(x, z, -y); // y is up in three.js
  viewer.controls.update();
  viewer.set_dirty();
}

function showCameras(cameras) {
  const list = element("camera");
  if (!cameras.length) list.remove();
  for (const camera of cameras) list.appendChild(new Option(camera.name));
  list.addEventListener("change", () => lookThrough(cameras[list.selectedIndex]));
  const found = /[#&]camera=([a-z%0-9+ ]+)/.exec(location.hash);
  const name = found && decodeURIComponent(found[1]);
  const place = cameras.findIndex((camera) => camera.name === name);
  if (place >= 0) { list.selectedIndex = place; lookThrough(cameras[place]); }
}

let plots, labels, origin = 0, length = 0;
const player = { ready: false, time: 0, get playing() { return viewer.animator.playing; }, seek, toggle };

function seek(time) { // s since the beginning of the recording
  player.time = Math.min(length, Math.max(0, time));
  if (player.playing) viewer.animator.pause();
  viewer.animator.seek(player.time);
  viewer.animator.display_progress(player.time);
}

function toggle() {
  if (player.playing) viewer.animator.pause(); else viewer.animator.play();
}

function refresh() {
  requestAnimationFrame(refresh);
  if (!CONFIG.live) {
    if (player.playing) player.time = viewer.animator.time;
    setText(element("play"), player.playing ? "❚❚" : "▶");
    element("time").value = player.time;
  }
  const now = origin + player.time;
  const whole = CONFIG.live ? "" : ` / ${(origin + length).toFixed(1)} s`;
  setText(element("clock"), `${now.toFixed(2)}${CONFIG.live ? " s" : whole}`);
  if (plots.time !== now) plots.mark(now);
  placeLabels(labels, now);
}

function start() {
  const movie = /[#&]movie/.test(location.hash); // what write_gif photographs
  const bare = /[#&]bare/.test(location.hash);
  if (movie || bare) document.body.className = movie ? "movie" : "bare";
  else if (!CONFIG.live && !CONFIG.length) document.body.className = "still";
  viewer.set_3d_pane_size();
  showLegend(CONFIG.legend);
  const panels = movie ? CONFIG.panels.slice(0, 1) : CONFIG.panels;
  plots = new Plots(element("plots"), panels, CONFIG.curves,
    CONFIG.live ? null : (time) => seek(time - origin));
  plots.window = CONFIG.window;
  labels = showLabels(CONFIG.labels);
  showCameras(CONFIG.cameras);
  origin = CONFIG.begin;
  length = CONFIG.length;
  element("time").max = length;
  element("time").addEventListener("input", (event) => seek(Number(event.target.value)));
  element("play").addEventListener("click", toggle);
  element("speed").addEventListener("change", (event) => {
    viewer.animator.mixer.timeScale = Number(event.target.value);
  });
  if (movie) nodeAt("twists").set_property("visible", false);
  const caption = element("caption");
  caption.classList.toggle("folded", window.innerWidth < 900);
  caption.querySelector("h1").addEventListener("click", () => caption.classList.toggle("folded"));
  window.addEventListener("keydown", (event) => {
    if (event.key === "g") {
      const gui = viewer.gui.domElement.style;
      gui.display = gui.display === "none" ? "" : "none";
    }
    if (event.key === " " && !CONFIG.live) { event.preventDefault(); toggle(); }
  });
  viewer.set_3d_pane_size();
  plots.redraw();
  const given = /t=([0-9.]+)/.exec(location.hash); // page.html#t=2.5 shows the still at 2.5 s
  const still = given ? Number(given[1]) : CONFIG.still;
  if (still !== null) seek(still - origin);
  if (CONFIG.live) live();
  refresh();
  player.ready = true;
}
