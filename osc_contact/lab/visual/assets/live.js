"use strict";
// A live view: drawing commands and numbers come over a websocket from the server of this page.

const LIVE = {
  socket: null,
  heard: 0, // ms, when the last picture came
  patience: 1500, // ms without a picture after which the page waits
  retry: 1000, // ms from one attempt to connect to the next
  attempts: 5, // in vain, after which the view has ended
};

function live() {
  for (const id of ["controls", "speed"]) element(id).style.display = "none";
  const badge = document.createElement("span");
  badge.id = "live";
  element("pace").prepend(badge);
  let failed = 0;

  function state(word) {
    badge.textContent = word;
    badge.className = word.toLowerCase();
  }

  function show(message) {
    LIVE.heard = performance.now();
    if (typeof message.data !== "string") {
      viewer.handle_command_bytearray(new Uint8Array(message.data));
      return;
    }
    state("LIVE");
    const { t, y } = JSON.parse(message.data), data = CONFIG.curves;
    if (data.t.length && t < data.t[data.t.length - 1]) { // the run has begun again
      data.t.length = 0;
      data.y.forEach((row) => { row.length = 0; });
    }
    data.t.push(t);
    data.y.forEach((row, i) => row.push(y[i]));
    while (data.t[0] < t - CONFIG.window) {
      data.t.shift();
      data.y.forEach((row) => row.shift());
    }
    player.time = t - origin;
    plots.redraw();
    const socket = LIVE.socket;
    requestAnimationFrame(() => { if (socket.readyState === 1) socket.send("."); });
  }

  function connect() {
    const socket = LIVE.socket = new WebSocket(`ws://${location.host}/frames`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { failed = 0; };
    socket.onmessage = show;
    socket.onclose = () => {
      failed += 1;
      state(failed > LIVE.attempts ? "ENDED" : "RECONNECTING");
      if (failed <= LIVE.attempts) setTimeout(connect, LIVE.retry);
    };
  }

  state("WAITING");
  connect();
  setInterval(() => {
    if (LIVE.socket.readyState === 1 && performance.now() - LIVE.heard > LIVE.patience) {
      state("WAITING");
    }
  }, 250);
}
