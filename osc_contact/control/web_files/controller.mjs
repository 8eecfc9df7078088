// Controllers of law.wasm, one for each .osc file; the same in a page, in a worker and in Node.js.

const ARRAYS = ["q", "v", "wrenches", "X_WD", "V_D", "A_D", "alpha_d", "squeeze_d", "active", "touched", "torques", "forces"];
const INPUTS = ["squeezed", "switched", "touching", "wrenchMissing", "repeated", "estimated", "wrenchAge"];
const RESULTS = ["status", "reason", "state", "cause", "culprit", "unbraked"];

/** The module's exports. source: its bytes, or the promise of a response that has them. */
export async function loadLaw(source) {
  const given = await source;
  const made = given instanceof ArrayBuffer || ArrayBuffer.isView(given)
    ? await WebAssembly.instantiate(given, {})
    : await WebAssembly.instantiateStreaming(given, {});
  const law = made.instance.exports;
  law._initialize?.();
  return law;
}

/** A text of the module, which ends with a zero. */
function textAt(law, address) {
  const bytes = new Uint8Array(law.memory.buffer);
  return new TextDecoder().decode(bytes.subarray(address, bytes.indexOf(0, address)));
}

/** The address of a copy of some bytes in the module's memory. */
function copied(law, bytes) {
  const address = law.osc_web_take(Math.max(bytes.length, 1));
  if (!address) throw new Error("no memory left for the controller");
  new Uint8Array(law.memory.buffer, address, bytes.length).set(bytes);
  return address;
}

/** A controller; fields named in ARRAYS are written before a tick, or read after it. */
export class Controller {
  /** law: see loadLaw. file: content of an .osc file. Throws a sentence where it is refused. */
  constructor(law, file) {
    this.law = law;
    const content = copied(law, file), error = law.osc_web_take(4);
    this.at = law.osc_web_open(content, file.length, error);
    const code = new Int32Array(law.memory.buffer, error, 1)[0];
    law.osc_web_give_back(content);
    law.osc_web_give_back(error);
    if (!this.at) throw new Error(textAt(law, law.osc_web_error_text(code)));
    this.period = law.osc_web_period(this.at);
    this.sizes = Object.fromEntries(ARRAYS.map((name, i) => [name, law.osc_web_count(this.at, i)]));
    this.look();
  }

  /** Arrays over the module's memory, made anew where it has grown. */
  look() {
    const { law, at } = this, buffer = this.buffer = law.memory.buffer;
    ARRAYS.forEach((name, i) => {
      this[name] = new Float64Array(buffer, law.osc_web_array(at, i), this.sizes[name]);
    });
    this.input = new Int32Array(buffer, law.osc_web_input(at), INPUTS.length);
    this.result = new Int32Array(buffer, law.osc_web_result(at), RESULTS.length);
  }

  /** What comes with the next ticks, besides the arrays: numbers by the names in INPUTS. */
  set(inputs) {
    for (const [name, value] of Object.entries(inputs)) this.input[INPUTS.indexOf(name)] = Number(value);
  }

  /** Torques of what the arrays hold; how the tick ended, by the names in RESULTS. */
  tick() {
    const code = this.law.osc_web_tick(this.at);
    if (code) throw new Error(textAt(this.law, this.law.osc_web_error_text(code)));
    return Object.fromEntries(RESULTS.map((name, i) => [name, this.result[i]]));
  }

  /** The sentence on a reason, with names in <> in place of values. */
  reasonText(reason) { return textAt(this.law, this.law.osc_web_reason_text(reason)); }

  /** Puts what is remembered between ticks, of a recording, into the controller. */
  setMemory(bytes) {
    const at = copied(this.law, bytes), code = this.law.osc_web_set_memory(this.at, at, bytes.length);
    this.law.osc_web_give_back(at);
    if (code) throw new Error(textAt(this.law, this.law.osc_web_error_text(code)));
  }

  /** A selection law for the next ticks, as osc_selection.c has it: point_m, force_axes, couple_axes. */
  select({ point_m, force_axes, couple_axes }) {
    const numbers = new Float64Array([point_m, ...force_axes, ...couple_axes].flat());
    const at = copied(this.law, new Uint8Array(numbers.buffer));
    const code = this.law.osc_web_select(this.at, force_axes.length, couple_axes.length, at);
    this.law.osc_web_give_back(at);
    if (code) throw new Error(textAt(this.law, this.law.osc_web_error_text(code)));
  }

  close() { this.law.osc_web_close(this.at); }
}

/** A set point that follows what is wanted without a jump, see osc_web_shape. */
export class SetPoint {
  /** pace: of the filter's pole, 1/s. */
  constructor(law, value, pace) {
    this.law = law;
    this.pace = pace;
    this.at = law.osc_web_take(24);
    this.wanted = value;
    this.state.set([value, 0, 0]);
  }

  /** Value, rate and second derivative. */
  get state() { return new Float64Array(this.law.memory.buffer, this.at, 3); }

  /** The same, one period later. */
  next(period) {
    this.law.osc_web_shape(this.at, this.wanted, this.pace, period);
    return this.state;
  }

  close() { this.law.osc_web_give_back(this.at); }
}
