// Plant and law of a task in this browser: MuJoCo's WebAssembly and law.wasm, tick by tick.
import loadMujoco from "./mujoco.js";
import { Controller, SetPoint, loadLaw } from "./controller.mjs";

const LAG = 6; // 1/s, of the filter between sliders and what they move
const BUSY_MS = 25; // of ticks at a stretch, so that messages are read in between
const SETTLED_S = 0.5; // after a change or a jump of a desired force, from which on errors are counted
const JUMP = 0.1; // of a desired force from tick to tick
const TEXTS = ["plant.xml", "task.json"];

// --- The plant ---------------------------------------------------------------------------------

/** MuJoCo's model of a task, as Python wrote it. */
class Plant {
  constructor(mujoco, xml, task, law) {
    this.mujoco = mujoco;
    this.task = task;
    this.model = mujoco.MjModel.from_xml_string(xml);
    this.data = new mujoco.MjData(this.model);
    this.force = new mujoco.DoubleBuffer(6);
    const bodies = mujoco.mjtObj.mjOBJ_BODY.value;
    this.idOf = (name) => mujoco.mj_name2id(this.model, bodies, name);
    this.object = this.idOf(task.object);
    this.nodes = task.nodes.map((node) => this.idOf(node.body));
    this.walls = task.walls.map((wall) => new Wall(this, wall, law));
    this.wallOf = Array.from(this.model.geom_bodyid, (body) => this.wallAbove(body));
    this.true = new Float64Array(this.walls.length);
  }

  /** The number of the wall that a body is part of; −1: of none. */
  wallAbove(body) {
    for (; body > 0; body = this.model.body_parentid[body]) {
      const found = this.walls.findIndex((wall) => wall.id === body);
      if (found >= 0) return found;
    }
    return -1;
  }

  reset() {
    this.mujoco.mj_resetData(this.model, this.data);
    this.data.qpos.set(this.task.start);
    this.mujoco.mj_forward(this.model, this.data);
  }

  hold(torques) {
    this.data.ctrl.set(torques);
    this.mujoco.mj_forward(this.model, this.data);
  }

  /** What encoders and wrists read, into a controller's arrays. */
  measure(controller) {
    const { positions, velocities, sensors } = this.task.places;
    const { qpos, qvel, sensordata } = this.data;
    positions.forEach((at, i) => { controller.q[i] = qpos[at]; });
    velocities.forEach((at, i) => { controller.v[i] = qvel[at]; });
    sensors.forEach((at, i) => { controller.wrenches[i] = at < 0 ? 0 : sensordata[at]; });
  }

  /** Normal force on each wall, as of the last step's beginning. */
  truth() {
    this.true.fill(0);
    const contacts = this.data.contact;
    for (let i = 0; i < contacts.size(); i++) {
      const one = contacts.get(i);
      const wall = Math.max(this.wallOf[one.geom[0]], this.wallOf[one.geom[1]]);
      if (wall >= 0) {
        this.mujoco.mj_contactForce(this.model, this.data, i, this.force);
        this.true[wall] += this.force.GetView()[0];
      }
      one.delete();
    }
    contacts.delete();
    return this.true;
  }

  /** Torques over a control period, with a force (3) at the object from outside. */
  command(torques, push, period) {
    this.data.ctrl.set(torques);
    this.data.xfrc_applied.set(push, 6 * this.object);
    for (const wall of this.walls) wall.move(this.model, period);
    for (let i = 0; i < this.task.steps; i++) this.mujoco.mj_step(this.model, this.data);
  }

  /** Place (3) and rotation (9, by rows) of each node's body. */
  places() {
    const { xpos, xmat } = this.data;
    return this.nodes.map((id) => [...xpos.subarray(3 * id, 3 * id + 3), ...xmat.subarray(9 * id, 9 * id + 9)]);
  }
}

/** A body of the environment that the page turns and moves, which the law does not see. */
class Wall {
  constructor(plant, about, law) {
    this.about = about;
    this.id = plant.idOf(about.body);
    this.place = [...plant.model.body_pos.subarray(3 * this.id, 3 * this.id + 3)];
    this.turn = [...plant.model.body_quat.subarray(4 * this.id, 4 * this.id + 4)];
    this.tilt = new SetPoint(law, 0, LAG);
    this.offset = new SetPoint(law, 0, LAG);
  }

  move(model, period) {
    const angle = this.tilt.next(period)[0], offset = this.offset.next(period)[0];
    const { axis, normal, point } = this.about, s = Math.sin(0.5 * angle), c = Math.cos(0.5 * angle);
    const [x, y, z] = axis.map((value) => s * value), [w0, x0, y0, z0] = this.turn;
    model.body_quat.set([
      c * w0 - x * x0 - y * y0 - z * z0, c * x0 + x * w0 + y * z0 - z * y0,
      c * y0 + y * w0 + z * x0 - x * z0, c * z0 + z * w0 + x * y0 - y * x0,
    ], 4 * this.id);
    const arm = this.place.map((value, i) => value - point[i]);
    const turned = rotated(axis, angle, arm);
    model.body_pos.set(turned.map((value, i) => point[i] + value + offset * normal[i]), 3 * this.id);
  }
}

/** A vector turned about a unit axis. */
function rotated(axis, angle, v) {
  const c = Math.cos(angle), s = Math.sin(angle), along = axis.reduce((sum, a, i) => sum + a * v[i], 0);
  const across = [axis[1] * v[2] - axis[2] * v[1], axis[2] * v[0] - axis[0] * v[2], axis[0] * v[1] - axis[1] * v[0]];
  return v.map((value, i) => c * value + s * across[i] + (1 - c) * along * axis[i]);
}

// --- References --------------------------------------------------------------------------------

/** The table of references that Python sampled, played to and fro. */
class Table {
  constructor(about, bytes, law, period) {
    this.about = about;
    this.ticks = about.ticks;
    this.period = period;
    this.rows = about.constant.map((value) => value);
    this.columns = about.columns.map(({ index, unit }, k) => ({ index, values: unfolded(bytes, k, about.ticks, unit) }));
    this.margin = Math.min(1, 0.25 * about.ticks * period); // s, in which the motion turns round
    this.pace = new SetPoint(law, 1, LAG / this.margin);
    this.amplitude = new SetPoint(law, 1, LAG);
    this.restart();
  }

  restart() {
    this.at = 0;
    this.speed = this.speed ?? 1;
    this.pace.state.set([this.speed, 0, 0]);
    this.pace.wanted = this.speed;
  }

  setSpeed(speed) {
    this.pace.wanted = Math.sign(this.pace.wanted || 1) * speed;
    this.speed = speed;
  }

  /** The row at the time reached, between two ticks the mean by distance. */
  row() {
    const low = Math.min(Math.floor(this.at), this.ticks - 1), high = Math.min(low + 1, this.ticks - 1);
    const share = this.at - low;
    for (const { index, values } of this.columns) {
      this.rows[index] = share ? values[low] + share * (values[high] - values[low]) : values[low];
    }
    return this.rows;
  }

  /** Writes the reference of this tick; forces are null where the table's own are played. */
  give(controller, forces) {
    const row = this.row(), [p, dp] = this.pace.state, [a, da, dda] = this.amplitude.state;
    const start = this.about.start;
    controller.X_WD.set(row.slice(0, 16));
    for (let i = 0; i < 6; i++) {
      const v = row[16 + i], second = row[22 + i], moved = i < 3 ? row[4 * i + 3] - start[i] : 0;
      const size = i < 3 ? a : 1;
      if (i < 3) controller.X_WD[4 * i + 3] = start[i] + a * moved;
      controller.V_D[i] = size * p * v + da * moved;
      controller.A_D[i] = size * (p * p * second + dp * v) + (i < 3 ? 2 * da * p * v + dda * moved : 0);
    }
    forces.forEach((value, i) => { controller.alpha_d[i] = value ?? row[28 + i]; });
  }

  next() {
    const ahead = this.margin * Math.max(this.speed, 0.1) / this.period;
    if (this.pace.wanted > 0 && this.at > this.ticks - 1 - ahead) this.pace.wanted = -this.speed;
    if (this.pace.wanted < 0 && this.at < ahead) this.pace.wanted = this.speed;
    this.at = Math.min(Math.max(this.at + this.pace.state[0], 0), this.ticks - 1);
    this.pace.next(this.period);
    this.amplitude.next(this.period);
  }
}

/** A column of a table from its third differences, whole multiples of a unit. */
function unfolded(bytes, column, ticks, unit) {
  const folded = new Int32Array(bytes.buffer, bytes.byteOffset + 4 * column * ticks, ticks);
  const values = new Float64Array(ticks);
  let first = 0, second = 0, third = 0;
  for (let k = 0; k < ticks; k++) {
    third += folded[k];
    second += third;
    first += second;
    values[k] = unit * first;
  }
  return values;
}

// --- The task ----------------------------------------------------------------------------------

/** One run: plant, controller and references, and what the page has changed. */
class Task {
  constructor(mujoco, law, files) {
    this.law = law;
    this.about = JSON.parse(files["task.json"]);
    this.file = files["controller.osc"];
    this.plant = new Plant(mujoco, files["plant.xml"], this.about, law);
    this.forces = this.about.forces.map(() => null);
    this.push = [0, 0, 0];
    this.table = new Table(this.about.references, files["references.bin"], law, this.about.period);
    this.restart(this.file);
  }

  /** Starts again with an .osc file; throws a sentence where it is refused. */
  restart(file) {
    const first = new Controller(this.law, file);
    const wanted = this.about.sizes, other = Object.keys(wanted).find((key) => first.sizes[key] !== wanted[key]);
    if (other || first.period !== this.about.period) {
      const words = other ? `${first.sizes[other]} numbers in ${other}, and ${wanted[other]} are needed here`
        : `a period of ${first.period} s, and ${this.about.period} s is needed here`;
      first.close();
      throw new Error(`the file is of another robot or task: it has ${words}`);
    }
    this.controller?.close();
    this.file = file;
    this.plant.reset();
    this.table.restart();
    this.plant.measure(first);
    this.table.give(first, this.forces);
    first.set({ squeezed: this.about.squeeze !== 0 });
    first.squeeze_d.fill(this.about.squeeze);
    first.tick();
    this.plant.hold(first.torques);
    first.close();
    this.controller = new Controller(this.law, file);
    this.controller.set({ squeezed: this.about.squeeze !== 0 });
    this.controller.squeeze_d.fill(this.about.squeeze);
    this.ticks = 0;
    this.samples = [];
    this.desired = [];
    this.changed();
  }

  /** Errors are counted anew. */
  changed() {
    this.since = this.ticks;
    this.errors = { count: 0, squares: this.forces.map(() => 0), peaks: this.forces.map(() => 0), path: 0 };
  }

  get time() { return this.ticks * this.about.period; }

  tick() {
    const { controller, plant, table } = this;
    if (controller.buffer !== this.law.memory.buffer) controller.look();
    plant.measure(controller);
    table.give(controller, this.forces);
    const walls = plant.truth();
    this.true = this.about.forces.map(({ wall }) => (wall < 0 ? null : walls[wall]));
    this.ended = controller.tick();
    const desired = controller.alpha_d;
    if (desired.some((value, i) => Math.abs(value - this.desired[i]) > JUMP)) this.since = this.ticks;
    this.desired = [...desired];
    if ((this.ticks - this.since) * this.about.period > SETTLED_S) this.judge();
    if (this.ticks % this.about.thinned === 0) this.samples.push(this.sample());
    table.next();
    plant.command(controller.torques, this.push, this.about.period);
    this.ticks += 1;
  }

  judge() {
    const { errors, controller } = this, id = 3 * this.plant.object, place = this.plant.data.xpos;
    errors.count += 1;
    this.true.forEach((value, i) => {
      const error = (value ?? controller.forces[i]) - controller.alpha_d[i];
      errors.squares[i] += error * error;
      errors.peaks[i] = Math.max(errors.peaks[i], Math.abs(error));
    });
    const away = [0, 1, 2].map((i) => place[id + i] - controller.X_WD[4 * i + 3]);
    errors.path = Math.max(errors.path, Math.hypot(...away));
  }

  sample() {
    const { controller } = this;
    return { t: this.time, commanded: [...controller.alpha_d], measured: [...controller.forces], true: [...this.true] };
  }

  picture() {
    const { ended, controller } = this, reason = ended.cause || ended.reason;
    const message = {
      kind: "picture", places: this.plant.places(), samples: this.samples, ...this.sample(), errors: this.errors,
      walls: this.plant.walls.map((wall) => wall.tilt.state[0]), status: ended.status, state: ended.state,
      reason: reason ? controller.reasonText(reason) : "",
    };
    this.samples = [];
    return message;
  }
}

// --- Messages ----------------------------------------------------------------------------------

let task, timer = 0, from = 0, begin = 0, running = false;

async function fetched(name) {
  const answer = await fetch(name);
  if (!answer.ok) throw new Error(`${name} is missing: ${answer.status} ${answer.statusText}`);
  return TEXTS.includes(name) ? answer.text() : new Uint8Array(await answer.arrayBuffer());
}

/** files: contents by name, of a page that has them inside; null: they are beside this one. */
async function open(files) {
  const names = [...TEXTS, "controller.osc", "references.bin"];
  const mujoco = loadMujoco(files ? { wasmBinary: files["mujoco.wasm"], locateFile: (name) => name } : {});
  const law = loadLaw(files ? files["law.wasm"] : fetch("law.wasm"));
  const contents = files ? names.map((name) => files[name]) : await Promise.all(names.map(fetched));
  task = new Task(await mujoco, await law, Object.fromEntries(names.map((name, i) => [name, contents[i]])));
  task.tick();
  postMessage({ kind: "ready", first: performance.timeOrigin + performance.now() });
  postMessage(task.picture());
}

/** As many ticks as time has passed; what is too slow does not run after it. */
function turn() {
  const until = performance.now() + BUSY_MS;
  const due = () => begin + 1e-3 * (performance.now() - from);
  while (task.time < due() && performance.now() < until) task.tick();
  if (task.time < due() - 0.1) pace();
  postMessage(task.picture());
}

function pace() {
  from = performance.now();
  begin = task.time;
}

function run(on) {
  running = on;
  clearInterval(timer);
  pace();
  if (on) timer = setInterval(turn, 16);
}

const ORDERS = {
  open: ({ files }) => open(files),
  run: ({ on }) => run(on),
  step: ({ ticks }) => { run(false); for (let k = 0; k < ticks; k++) task.tick(); postMessage(task.picture()); },
  force: ({ index, value }) => { task.forces[index] = value; task.changed(); },
  speed: ({ value }) => { task.table.setSpeed(value); task.changed(); },
  amplitude: ({ value }) => { task.table.amplitude.wanted = value; task.changed(); },
  tilt: ({ wall, value }) => { task.plant.walls[wall].tilt.wanted = value; task.changed(); },
  offset: ({ wall, value }) => { task.plant.walls[wall].offset.wanted = value; task.changed(); },
  push: ({ force }) => { task.push = force; task.changed(); },
  restart: ({ file }) => { task.restart(file ?? task.file); pace(); task.tick(); postMessage(task.picture()); },
  flat: (wanted) => flat(wanted), // without pictures, as fast as it goes: for measurements
};

function flat({ ticks, note, anew }) {
  const on = running, truths = [], statuses = {};
  run(false);
  if (anew) task.restart(task.file);
  const before = performance.now();
  for (let k = 0; k < ticks; k++) {
    task.tick();
    if (note) truths.push(...task.true, ...task.controller.alpha_d);
    statuses[task.ended.status] = (statuses[task.ended.status] ?? 0) + 1;
  }
  task.samples = [];
  const factor = ticks * task.about.period / (1e-3 * (performance.now() - before));
  const heaps = [task.plant.data.qpos.buffer.byteLength, task.law.memory.buffer.byteLength];
  postMessage({ kind: "flat", factor, statuses, truths, heaps });
  if (on) run(true);
}

onmessage = async ({ data }) => {
  try {
    await ORDERS[data.kind](data);
  } catch (error) {
    postMessage({ kind: "error", order: data.kind, text: sentence(error) });
  }
};

/** An error in words; MuJoCo's script makes functions of text, which a page's policy may forbid. */
function sentence(error) {
  if (error instanceof EvalError || /unsafe-eval/.test(error.message)) {
    return "this page's policy forbids what MuJoCo's script needs: add 'unsafe-eval' to script-src of its "
      + "Content-Security-Policy";
  }
  return error.message || String(error);
}
