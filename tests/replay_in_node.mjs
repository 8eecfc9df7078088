// Replays recordings of `osc-contact build` by law.wasm; prints how far its ticks are from those.
//   node replay_in_node.mjs law.wasm controller.mjs FOLDER …
// A folder with selection.json was recorded under that selection law.
import { existsSync, readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const MEMORY = 1, TOUCHED = 2, WRENCH_MISSING = 4, ESTIMATED = 8, SQUEEZE = 16, ACTIVE = 32;
const NOISY = 64, REPEATED = 7n;
const [, , module, wrapper, ...folders] = process.argv;
const { loadLaw, Controller } = await import(pathToFileURL(wrapper));
const law = await loadLaw(readFileSync(module));

function replay(folder) {
  const controller = new Controller(law, new Uint8Array(readFileSync(`${folder}/controller.osc`)));
  const selection = `${folder}/selection.json`;
  if (existsSync(selection)) controller.select(JSON.parse(readFileSync(selection, "utf8")));
  const bytes = readFileSync(`${folder}/recording.osc`);
  const tape = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);
  let at = 8;
  const whole = () => { const value = new BigInt64Array(tape, at, 1)[0]; at += 8; return value; };
  const numbers = (count) => { const x = new Float64Array(tape, at, count); at += 8 * count; return x; };
  const count = Number(whole()), memoryBytes = Number(whole());
  const statuses = {};
  let others = 0, worst = 0, scale = 0, spent = 0;
  for (let k = 0; k < count; k++) {
    const word = whole(), flags = Number(word), status = Number(whole()), age = Number(whole());
    if (flags & MEMORY) {
      controller.setMemory(new Uint8Array(tape, at, memoryBytes));
      at += memoryBytes;
    }
    if (controller.buffer !== law.memory.buffer) controller.look();
    for (const name of ["q", "v", "wrenches", "X_WD", "V_D", "A_D", "alpha_d"]) {
      controller[name].set(numbers(controller.sizes[name]));
    }
    if (flags & SQUEEZE) controller.squeeze_d.set(numbers(controller.sizes.squeeze_d));
    if (flags & TOUCHED) controller.touched.set(numbers(controller.sizes.touched));
    if (flags & ACTIVE) controller.active.set(numbers(controller.sizes.active));
    controller.set({
      squeezed: flags & SQUEEZE, switched: flags & ACTIVE, touching: flags & TOUCHED, wrenchMissing: (flags & WRENCH_MISSING) !== 0,
      estimated: Number((flags & ESTIMATED) !== 0) + Number((flags & NOISY) !== 0), repeated: word >> REPEATED, wrenchAge: age,
    });
    const recorded = numbers(controller.sizes.torques);
    const before = performance.now(), ended = controller.tick();
    spent += performance.now() - before;
    statuses[ended.status] = (statuses[ended.status] ?? 0) + 1;
    others += ended.status !== status;
    recorded.forEach((value, i) => {
      worst = Math.max(worst, Math.abs(value - controller.torques[i]));
      scale = Math.max(scale, Math.abs(value));
    });
  }
  controller.close();
  return { ticks: count, statuses, otherStatuses: others, worst, largest: scale, microseconds: 1e3 * spent / count };
}

console.log(JSON.stringify(folders.map(replay)));
