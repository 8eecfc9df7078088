"use strict";
// A live view: drawing commands and numbers come over a websocket from the server of this page.

function live() {
  for (const id of ["controls", "speed"]) element(id).style.display = "none";
  const badge = document.createElement("span");
  badge.id = "live";
  element("pace").prepend(badge);
  badge.textContent = "LIVE";
  const socket = new WebSocket(`ws://${location.host}/frames`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (message) => {
    if (typeof message.data !== "string") {
      viewer.handle_command_bytearray(new Uint8Array(message.data));
      return;
    }
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
    requestAnimationFrame(() => { if (socket.readyState === 1) socket.send("."); });
  };
  socket.onclose = () => {
    badge.textContent = "ENDED";
    badge.className = "ended";
  };
}
