// Plant and law of a task in this browser: MuJoCo's WebAssembly and law.wasm, tick by tick.
import loadMujoco from "./mujoco.js";
import { Controller, SetPoint, loadLaw } from "./controller.mjs";

const LAG = 6; // 1/s, of the filter between sliders and what they move
const BUSY_MS = 25; // of ticks at a stretch, so that messages are read in between
const IN_STEP_S = 0.05; // behind the clock, above which a picture waits: to draw it takes the time of ticks
const PICTURE_MS = 500; // longest wait of a picture
const DELAY_S = 0.5; // behind the clock, above which the delay is dropped instead of made up for
const SETTLED_S = 0.5; // after a change or a jump of a desired force, from which on errors are counted
const JUMP = 0.1; // of a desired force from tick to tick
const TEXTS = ["plant.xml", "task.json"];
const PAIR_FIELDS = ["pair_dim", "pair_friction", "pair_solref", "pair_solimp"];

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
    this.rough = Object.fromEntries(PAIR_FIELDS.map((name) => [name, [...this.model[name]]]));
    this.losses = [...this.model.dof_frictionloss];
    this.setFriction(task.friction);
  }

  /** Coefficient of friction of the contacts; 0: contacts without friction, as Python writes them. */
  setFriction(coefficient) {
    const { model, rough, task } = this;
    for (const name of PAIR_FIELDS) model[name].set(rough[name]);
    for (let i = 0; i < model.npair; i++) {
      model.pair_friction.set([coefficient, coefficient], 5 * i);
      if (coefficient > 0) continue;
      model.pair_dim.set([1], i);
      model.pair_solref.set(task.smooth.solref, 2 * i);
      model.pair_solimp.set(task.smooth.solimp, 5 * i);
    }
  }

  /** Dry friction that the joints have besides their model's, as a share of their motors' limits. */
  setJointFriction(share) {
    const { velocities, limits } = this.task.places;
    velocities.forEach((at, i) => { this.model.dof_frictionloss.set([this.losses[at] + share * limits[i]], at); });
  }

  close() {
    for (const wall of this.walls) wall.close();
    for (const one of [this.force, this.data, this.model]) one.delete();
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

  close() {
    this.tilt.close();
    this.offset.close();
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

  close() {
    this.pace.close();
    this.amplitude.close();
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
  /** files: contents by name. selection: of a selection law; null: the controller's own law. */
  constructor(mujoco, law, files, selection = null) {
    this.law = law;
    this.selection = selection;
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
    this.plant.measure(this.prepared(first));
    this.table.give(first, this.forces);
    first.tick();
    this.plant.hold(first.torques);
    first.close();
    this.controller = this.prepared(new Controller(this.law, file));
    this.ticks = 0;
    this.desired = [];
    this.changed();
  }

  /** A new controller with its law and with what is the same in all ticks. */
  prepared(controller) {
    controller.set({ squeezed: this.about.squeeze !== 0 });
    controller.squeeze_d.fill(this.about.squeeze);
    if (this.selection) controller.select(this.selection);
    return controller;
  }

  close() {
    this.controller.close();
    this.table.close();
    this.plant.close();
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
    this.settled = (this.ticks - this.since) * this.about.period > SETTLED_S;
    if (this.settled) this.judge();
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

  /** What the page shows of this tick. */
  shown() {
    const { ended, controller, errors } = this, reason = ended.cause || ended.reason;
    return {
      true: [...this.true], measured: [...controller.forces], errors, status: ended.status, state: ended.state,
      reason: reason ? controller.reasonText(reason) : "",
    };
  }
}

// --- Messages ----------------------------------------------------------------------------------

let task, beside = null; // the task, and the same under a selection law
let made, samples = [], settings = new Map(), timer = 0, from = 0, begin = 0, shown = 0, running = false;

const tasks = () => (beside ? [task, beside] : [task]);

/** One tick of each task. */
function tick() {
  for (const one of tasks()) one.tick();
  if (task.ticks % task.about.thinned === 1 % task.about.thinned) samples.push(sample());
}

function sample() {
  const { controller, about, ticks } = task;
  return {
    t: (ticks - 1) * about.period, commanded: [...controller.alpha_d], measured: [...controller.forces],
    true: [...task.true], error: errorsOf(task), selection: beside ? errorsOf(beside) : [],
  };
}

/** Errors of the forces in mN, of ticks that are judged. */
function errorsOf(one) {
  return one.settled ? forcesOf(one).map((value, i) => 1e3 * (value - one.controller.alpha_d[i])) : [];
}

/** True forces, or measured ones where several share a wall. */
const forcesOf = ({ true: known, controller }) => known.map((value, i) => value ?? controller.forces[i]);

function show() {
  const { plant } = task;
  shown = performance.now();
  postMessage({
    kind: "picture", places: plant.places(), walls: plant.walls.map((wall) => wall.tilt.state[0]), samples,
    ...sample(), ...task.shown(), beside: beside?.shown() ?? null,
  });
  samples = [];
}

function restart(file) {
  task.restart(file);
  beside?.restart(file);
  samples = [];
  pace();
  tick();
  show();
}

/** Runs the same task under a selection law beside, or no longer; both begin again. */
function compare(on) {
  beside?.close();
  beside = on ? new Task(...made, task.about.selection) : null;
  if (beside) for (const [setting, value] of settings.values()) setting(beside, value);
  restart(task.file);
}

/** Something that the page sets, in all tasks; key: of the setting. */
function set(key, setting, value) {
  settings.set(key, [setting, value]);
  for (const one of tasks()) {
    setting(one, value);
    one.changed();
  }
}

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
  made = [await mujoco, await law, Object.fromEntries(names.map((name, i) => [name, contents[i]]))];
  task = new Task(...made);
  tick();
  postMessage({ kind: "ready", first: performance.timeOrigin + performance.now() });
  show();
}

/**
 * As many ticks as time has passed. Behind the clock pictures become rarer, as their drawing shares the
 * processor with the ticks; a delay of more than DELAY_S is dropped.
 */
function turn() {
  const until = performance.now() + BUSY_MS;
  const due = () => begin + 1e-3 * (performance.now() - from);
  while (task.time < due() && performance.now() < until) tick();
  const behind = due() - task.time;
  if (behind > DELAY_S) pace();
  if (behind < IN_STEP_S || performance.now() > shown + PICTURE_MS) show();
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
  step: ({ ticks }) => { run(false); for (let k = 0; k < ticks; k++) tick(); show(); },
  force: ({ index, value }) => set(`force ${index}`, (one, x) => { one.forces[index] = x; }, value),
  speed: ({ value }) => set("speed", (one, x) => one.table.setSpeed(x), value),
  amplitude: ({ value }) => set("amplitude", (one, x) => { one.table.amplitude.wanted = x; }, value),
  tilt: ({ wall, value }) => set(`tilt ${wall}`, (one, x) => { one.plant.walls[wall].tilt.wanted = x; }, value),
  offset: ({ wall, value }) => set(`offset ${wall}`, (one, x) => { one.plant.walls[wall].offset.wanted = x; }, value),
  friction: ({ value }) => set("friction", (one, x) => one.plant.setFriction(x), value),
  jointFriction: ({ value }) => set("joint friction", (one, x) => one.plant.setJointFriction(x), value),
  push: ({ force }) => set("push", (one, x) => { one.push = x; }, force),
  restart: ({ file }) => restart(file ?? task.file),
  compare: ({ on }) => compare(on),
  flat: (wanted) => flat(wanted), // without pictures, as fast as it goes: for measurements
};

function flat({ ticks, note, anew }) {
  const on = running, truths = [], statuses = {};
  run(false);
  if (anew) for (const one of tasks()) one.restart(one.file);
  const before = performance.now();
  for (let k = 0; k < ticks; k++) {
    for (const one of tasks()) one.tick();
    if (note) truths.push(...forcesOf(task), ...task.controller.alpha_d);
    statuses[task.ended.status] = (statuses[task.ended.status] ?? 0) + 1;
  }
  const factor = ticks * task.about.period / (1e-3 * (performance.now() - before));
  samples = [];
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
