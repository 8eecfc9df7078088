"use strict";
// Small plots of time series: panels below one another with one time axis and one time marker.

const INK = "#1c2127", SOFT = "#67707c", RULE = "#e6e9ec", MARKER = "#1c2127";
const LEFT = 58, RIGHT = 18, TOP = 19;
const FONT = '11px "Helvetica Neue", Helvetica, Arial, "Liberation Sans", sans-serif';

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((s) => s >= raw * 0.999);
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return { step, found };
}

// A proper minus sign, and none before zero.
function signed(number) {
  return (Number(number) === 0 ? number.replace("-", "") : number).replace("-", "−");
}

function words(value, step) {
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return signed(value.toFixed(digits));
}

class Plots {
  constructor(parent, panels, data, onSeek) {
    this.panels = panels;
    this.data = data;
    this.shown = [];
    let first = 0;
    for (const panel of panels) {
      const box = parent.appendChild(document.createElement("div"));
      box.className = "panel";
      const [base, over] = [0, 1].map(() => box.appendChild(document.createElement("canvas")));
      this.shown.push({ panel, first, box, base, over, last: panel === panels[panels.length - 1] });
      first += panel.lines.length;
      if (onSeek) {
        box.style.cursor = "pointer";
        const go = (event) => { if (event.buttons & 1) onSeek(this.timeAt(event.offsetX)); };
        over.addEventListener("pointerdown", (e) => { over.setPointerCapture(e.pointerId); go(e); });
        over.addEventListener("pointermove", go);
      }
    }
    window.addEventListener("resize", () => this.redraw());
  }

  get span() {
    const t = this.data.t;
    if (this.window) return [Math.max(t[0] ?? 0, (t[t.length - 1] ?? 0) - this.window), null];
    return [t[0] ?? 0, t[t.length - 1] ?? 1];
  }

  range() {
    const [from, to] = this.span, t = this.data.t;
    const end = to ?? Math.max(t[t.length - 1] ?? 1, from + Math.min(1, this.window));
    return [from, end > from ? end : from + 1];
  }

  timeAt(x) {
    const [from, to] = this.range(), width = this.shown[0].box.clientWidth - LEFT - RIGHT;
    return from + (to - from) * Math.min(1, Math.max(0, (x - LEFT) / width));
  }

  valueAt(line, time) {
    const t = this.data.t, y = this.data.y[line];
    let low = 0, high = t.length - 1;
    if (high < 0) return null;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (t[middle] <= time) low = middle; else high = middle;
    }
    if (y[low] === null || y[high] === null || t[high] === t[low]) return y[high];
    const s = Math.min(1, Math.max(0, (time - t[low]) / (t[high] - t[low])));
    return y[low] + s * (y[high] - y[low]);
  }

  paper(canvas, box) {
    const ratio = window.devicePixelRatio || 1, w = box.clientWidth, h = box.clientHeight;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      canvas.width = Math.round(w * ratio);
      canvas.height = Math.round(h * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = FONT;
    return pen;
  }

  redraw() {
    for (const shown of this.shown) this.drawBase(shown);
    this.mark(this.time ?? this.span[0]);
  }

  drawBase(shown) {
    const { panel, first, box, base, last } = shown, pen = this.paper(base, box);
    const w = box.clientWidth - LEFT - RIGHT, h = box.clientHeight - TOP - (last ? 22 : 7);
    const [from, to] = this.range(), t = this.data.t;
    let low = Infinity, high = -Infinity;
    panel.lines.forEach((_, k) => t.forEach((time, i) => {
      const value = this.data.y[first + k][i];
      if (value === null || time < from) return;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }));
    if (!(high > low)) [low, high] = high === low ? [low - 1, high + 1] : [0, 1];
    if (low > 0 && low < 0.5 * high) low = 0;
    const margin = 0.06 * (high - low);
    if (low !== 0) low -= margin;
    high += margin;
    const X = (time) => LEFT + (w * (time - from)) / (to - from);
    const Y = (value) => TOP + (h * (high - value)) / (high - low);
    shown.frame = { X, w, h };
    const vertical = ticks(low, high, Math.max(3, Math.floor(h / 24)));
    pen.strokeStyle = RULE;
    pen.lineWidth = 1;
    pen.fillStyle = SOFT;
    pen.textBaseline = "middle";
    pen.textAlign = "right";
    for (const value of vertical.found) {
      const y = Math.round(Y(value)) + 0.5;
      pen.beginPath();
      pen.moveTo(LEFT, y);
      pen.lineTo(LEFT + w, y);
      pen.stroke();
      pen.fillText(words(value, vertical.step), LEFT - 7, y);
    }
    if (last) {
      const horizontal = ticks(from, to, Math.max(2, Math.floor(w / 90)));
      pen.textAlign = "center";
      for (const time of horizontal.found) {
        if (X(time) < LEFT + w - 16) pen.fillText(words(time, horizontal.step), X(time), TOP + h + 12);
      }
      pen.textAlign = "right";
      pen.fillText("s", LEFT + w, TOP + h + 12);
    }
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, TOP - 2, w, h + 4);
    pen.clip();
    pen.lineJoin = "round";
    panel.lines.forEach((line, k) => {
      pen.strokeStyle = line.colour;
      pen.globalAlpha = line.look === "pale" ? 0.28 : 1;
      pen.lineWidth = { pale: 6, solid: 1.7, dashed: 0.9, dotted: 1.7 }[line.look] ?? 1;
      pen.setLineDash({ dashed: [4, 5], dotted: [2, 3] }[line.look] ?? []);
      pen.beginPath();
      let down = false;
      t.forEach((time, i) => {
        const value = this.data.y[first + k][i];
        if (value === null) { down = false; return; }
        if (down) pen.lineTo(X(time), Y(value)); else pen.moveTo(X(time), Y(value));
        down = true;
      });
      pen.stroke();
    });
    pen.restore();
  }

  mark(time) {
    this.time = time;
    for (const { panel, first, box, over, frame } of this.shown) {
      const pen = this.paper(over, box);
      if (!frame) continue;
      const x = Math.min(LEFT + frame.w, Math.max(LEFT, frame.X(time)));
      pen.fillStyle = MARKER;
      pen.fillRect(x - 0.75, TOP - 3, 1.5, frame.h + 6);
      pen.textBaseline = "middle";
      pen.textAlign = "left";
      pen.font = "600 " + FONT;
      pen.fillStyle = INK;
      const title = `${panel.title} (${panel.unit})`;
      pen.fillText(title, LEFT, 8);
      let left = LEFT + pen.measureText(title).width + 12;
      pen.font = FONT;
      pen.fillStyle = SOFT;
      const named = panel.lines.map((line, k) => ({ line, k })).filter(({ line }) => line.name);
      const readings = named.map(({ line, k }) => {
        const value = this.valueAt(first + k, time);
        const number = value === null ? "–" : value.toFixed(Math.abs(value) < 0.995 ? 3 : 2);
        return { text: `${line.name} ${signed(number)} ${panel.unit}`, colour: line.colour };
      });
      const room = LEFT + frame.w - left;
      const needed = () => readings.reduce((sum, r) => sum + pen.measureText(r.text).width * 1.08 + 28, 0);
      if (needed() > room) named.forEach(({ line }, k) => { readings[k].text = line.name; });
      if (needed() > room) readings.length = 0;
      const width = readings.reduce((sum, r) => sum + pen.measureText(r.text).width * 1.08 + 30, 0);
      if (left + pen.measureText(panel.note).width + width < LEFT + frame.w) {
        pen.fillText(panel.note, left, 8);
      }
      pen.font = "600 " + FONT;
      let right = LEFT + frame.w;
      pen.textAlign = "right";
      for (const { text, colour } of readings.reverse()) {
        pen.fillStyle = INK;
        pen.fillText(text, right, 8);
        right -= pen.measureText(text).width + 6;
        pen.fillStyle = colour;
        pen.fillRect(right - 10, 4, 10, 8);
        right -= 28;
      }
    }
  }
}
