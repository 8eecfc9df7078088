"use strict";
// In the place of the live view's socket: a worker that runs plant and law in this browser.

/** What tests and the curious read: when the first tick was over, pictures, the newest message. */
const measured = { pictures: 0 };

function live() {
  const task = CONFIG.task, worker = window.task;
  for (const id of ["controls", "speed"]) element(id).style.display = "none";
  const measureDock = () => document.body.style.setProperty("--dock", `${element("dock").offsetHeight}px`);
  new ResizeObserver(measureDock).observe(element("dock"));
  const send = (kind, more = {}) => worker.postMessage({ kind, ...more });
  const panel = new Panel(task, send);
  let newest = null;

  function hear({ data }) {
    if (data.kind === "ready") {
      measured.firstTick = data.first - performance.timeOrigin;
      panel.begin();
    } else if (data.kind === "picture") {
      data.samples.forEach(note);
      newest = data;
    } else if (data.kind === "error") {
      measured.error = data.text;
      panel.complain(data.text);
    } else {
      measured[data.kind] = data;
    }
  }

  /** One sample into the curves, in the order of the plots' lines. */
  function note(sample) {
    const { t, y } = CONFIG.curves;
    if (t.length && sample.t < t[t.length - 1]) {
      t.length = 0;
      y.forEach((row) => { row.length = 0; });
    }
    t.push(sample.t);
    task.lines.forEach(({ key, index }, i) => y[i].push(sample[key][index] ?? null));
    while (t[0] < sample.t - CONFIG.window) {
      t.shift();
      y.forEach((row) => row.shift());
    }
  }

  function draw() {
    requestAnimationFrame(draw);
    if (!newest) return;
    const picture = measured.newest = newest;
    newest = null;
    measured.pictures += 1;
    task.nodes.forEach((node, i) => placeNode(node, picture.places[i]));
    task.forces.forEach((force, i) => drawForce(force, picture, i));
    viewer.set_dirty();
    player.time = picture.t - origin;
    plots.redraw();
    panel.show(picture);
  }

  worker.onmessage = hear;
  worker.onerror = (event) => panel.complain(`the worker does not start: ${event.message}`);
  for (const message of window.early.splice(0)) hear(message);
  draw();
}

// --- The scene -----------------------------------------------------------------------------------

const matrixOf = (numbers) => new MeshCat.THREE.Matrix4().set(...numbers);

/** A place (3) and a rotation (9, by rows) as a matrix. */
const poseOf = (p) => matrixOf([p[3], p[4], p[5], p[0], p[6], p[7], p[8], p[1], p[9], p[10], p[11], p[2], 0, 0, 0, 1]);

function placeNode(node, place) {
  const pose = poseOf(place).multiply(matrixOf(node.offset));
  nodeAt(node.path).set_transform(pose.elements);
  node.pose = pose;
}

/** A contact's arrows: they stay at their point of the object, and turn with the wall. */
function drawForce(force, picture, index) {
  const object = CONFIG.task.nodes.find((node) => node.object), wall = CONFIG.task.walls[force.turnsWith];
  const pose = matrixOf(force.rotation);
  if (wall) {
    const axis = new MeshCat.THREE.Vector3(...wall.axis);
    pose.premultiply(new MeshCat.THREE.Matrix4().makeRotationAxis(axis, picture.walls[force.turnsWith]));
  }
  const at = new MeshCat.THREE.Vector3(...force.point).applyMatrix4(object.pose);
  pose.setPosition(at);
  nodeAt(force.path).set_transform(pose.elements);
  const values = { true: picture.true[index] ?? picture.measured[index], commanded: picture.commanded[index], measured: picture.measured[index] };
  const touches = values.true > 0;
  nodeAt(`${force.path}/closed`).set_property("visible", touches);
  nodeAt(`${force.path}/lost`).set_property("visible", !touches);
  nodeAt(`${force.path}/known`).set_property("visible", false);
  let longest = 0;
  for (const name of force.arrows) {
    const length = force.unit * values[name], head = CONFIG.task.head, size = Math.min(1, Math.max(length, 1e-6) / head);
    nodeAt(`${force.path}/${name}`).set_property("visible", length > 0.1 * force.unit * 0.01);
    stretch(`${force.path}/${name}/shaft`, size, Math.max(length - head, 1e-6), -head * size);
    stretch(`${force.path}/${name}/head`, size, size, 0);
    longest = Math.max(longest, length);
  }
  nodeAt(`${force.path}/label`).set_transform(matrixOf([1, 0, 0, 0, 0, 1, 0, -longest - 0.045, 0, 0, 1, 0, 0, 0, 0, 1]).elements);
}

function stretch(path, wide, long, up) {
  nodeAt(path).set_transform(matrixOf([wide, 0, 0, 0, 0, long, 0, up, 0, 0, wide, 0, 0, 0, 0, 1]).elements);
}

// --- The panel -----------------------------------------------------------------------------------

/** Sliders, buttons and figures. */
class Panel {
  constructor(task, send) {
    this.task = task;
    this.send = send;
    this.on = true;
    const box = element("sliders");
    task.forces.forEach((force, index) => {
      this.slider(box, `force ${force.name}`, force.unitName, 0, force.most, force.step, force.mean, 1,
        (value) => send("force", { index, value }));
    });
    if (task.moves) {
      this.slider(box, "pace of the motion", "×", 0, 1.5, 0.05, 1, 1, (value) => send("speed", { value }));
    }
    if (task.slides) {
      this.slider(box, "size of the motion", "×", 0, 1.2, 0.05, 1, 1, (value) => send("amplitude", { value }));
    }
    task.walls.forEach((wall, index) => {
      this.slider(box, `${wall.name}: turned by`, "°", -8, 8, 0.5, 0, Math.PI / 180,
        (value) => send("tilt", { wall: index, value }));
      this.slider(box, `${wall.name}: moved by`, "mm", -5, 5, 0.5, 0, 1e-3,
        (value) => send("offset", { wall: index, value }));
    });
    this.slider(box, "friction of the contacts", "", 0, 0.5, 0.01, task.friction, 1, (value) => send("friction", { value }));
    this.slider(box, "friction of the joints", "%", 0, 3, 0.1, 0, 0.01,
      (value) => send("jointFriction", { value }));
    element("compared").hidden = !task.compares;
    element("compare").addEventListener("change", ({ target }) => {
      document.body.classList.toggle("comparing", target.checked);
      send("compare", { on: target.checked });
    });
    element("pause").addEventListener("click", () => this.run(!this.on));
    element("step").addEventListener("click", () => this.step());
    element("again").addEventListener("click", () => this.again());
    element("file").addEventListener("change", async ({ target }) => {
      if (!target.files.length) return;
      this.complain("");
      send("restart", { file: new Uint8Array(await target.files[0].arrayBuffer()) });
    });
    element("panel").open = window.innerWidth >= 700;
    element("push").addEventListener("change", () => element("scene").classList.toggle("pushing", element("push").checked));
    this.pushing();
    window.addEventListener("keydown", (event) => this.key(event));
    this.rows = task.forces.map((force) => this.row(force.name));
    this.path = this.row("off the path, mm");
  }

  /** One slider; `tell` is called with its value times `unit`. */
  slider(box, name, unitName, low, high, step, value, unit, tell) {
    const label = box.appendChild(document.createElement("label")), words = label.appendChild(document.createElement("span"));
    const input = label.appendChild(document.createElement("input"));
    Object.assign(input, { type: "range", min: low, max: high, step, value, name });
    const show = () => { words.textContent = `${name}: ${signed(String(Number(input.value)))} ${unitName}`; };
    input.addEventListener("input", () => { show(); tell(unit * Number(input.value)); });
    show();
  }

  row(name) {
    const row = element("figures").appendChild(document.createElement("tr"));
    row.appendChild(document.createElement("th")).textContent = name;
    return [0, 1, 2, 3].map((column) => {
      const cell = row.appendChild(document.createElement("td"));
      if (column > 1) cell.className = "beside";
      return cell;
    });
  }

  begin() {
    setText(element("says"), "");
    this.run(true);
  }

  run(on) {
    this.on = on;
    setText(element("pause"), on ? "Pause" : "Run");
    this.send("run", { on });
  }

  step() {
    this.run(false);
    this.send("step", { ticks: 1 });
  }

  again() {
    this.complain("");
    this.send("restart");
    this.run(true);
  }

  complain(text) { setText(element("says"), text); }

  key(event) {
    if (event.target.matches("input, select, button, summary")) return;
    const found = { " ": () => this.run(!this.on), ".": () => this.step(), r: () => this.again() }[event.key];
    if (!found) return;
    event.preventDefault();
    found();
  }

  /** The object is pushed while the pointer is dragged, in the plane of the picture. */
  pushing() {
    const scene = element("scene");
    let start = null;
    const stop = (event) => {
      if (start) this.send("push", { force: [0, 0, 0] });
      start = null;
      event.stopPropagation();
    };
    const listen = (kind, react) => scene.addEventListener(kind, (event) => {
      if (element("push").checked) react(event);
    }, { capture: true });
    listen("pointerdown", (event) => {
      start = [event.clientX, event.clientY];
      scene.setPointerCapture(event.pointerId);
      event.stopPropagation();
    });
    listen("pointermove", (event) => {
      event.stopPropagation();
      if (!start) return;
      const limit = (pixels) => Math.max(-this.task.push, Math.min(this.task.push, 0.1 * pixels));
      const right = limit(event.clientX - start[0]), up = limit(start[1] - event.clientY);
      const e = viewer.camera.matrixWorld.elements; // y is up in three.js
      const force = [right * e[0] + up * e[4], -(right * e[2] + up * e[6]), right * e[1] + up * e[5]];
      this.send("push", { force });
      this.complain(`pushed by ${Math.hypot(right, up).toFixed(1)} N`);
    });
    listen("pointerup", (event) => { stop(event); this.complain(""); });
    listen("pointercancel", stop);
  }

  show(picture) {
    this.figures(picture.errors, 0);
    if (picture.beside) this.figures(picture.beside.errors, 2);
    setText(element("status"), this.words(picture));
    setText(element("status-beside"), picture.beside ? `selection law: ${this.words(picture.beside)}` : "");
  }

  /** Errors into the table, from a column on. */
  figures({ count, squares, peaks, path }, column) {
    const digits = (x) => (count ? (1e3 * x).toFixed(2) : "–");
    this.rows.forEach((cells, i) => {
      setText(cells[column], digits(Math.sqrt(squares[i] / Math.max(count, 1))));
      setText(cells[column + 1], digits(peaks[i]));
    });
    setText(this.path[column + 1], digits(path));
  }

  words({ state, status, reason }) {
    const words = `${this.task.states[state]}, tick ${this.task.statuses[status]}`;
    return reason ? `${words}: ${reason}` : words;
  }
}
