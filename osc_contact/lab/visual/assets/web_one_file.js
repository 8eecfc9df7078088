// All files of a page are inside: they are unfolded, and the worker begins with them.
window.early = [];
window.task = {
  orders: [], // of the page, before there is a worker
  postMessage(order) { this.orders.push(order); },
};
(async () => {
  const packed = {{packed}};
  const texts = ["plant.xml", "task.json", "worker.js"], files = {};
  for (const [name, text] of Object.entries(packed)) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const content = await new Response(stream).arrayBuffer();
    files[name] = texts.includes(name) ? new TextDecoder().decode(content) : new Uint8Array(content);
  }
  // a classic worker: from disk Chromium refuses modules
  const worker = new Worker(URL.createObjectURL(new Blob([files["worker.js"]], { type: "text/javascript" })));
  delete files["worker.js"];
  const hear = (message) => (window.task.onmessage ? window.task.onmessage(message) : window.early.push(message));
  worker.onmessage = hear;
  worker.onerror = (event) => hear({ data: { kind: "error", text: `the worker does not start: ${event.message}` } });
  worker.postMessage({ kind: "open", files });
  for (const order of window.task.orders) worker.postMessage(order);
  window.task.postMessage = (order) => worker.postMessage(order);
})().catch((error) => window.early.push({ data: { kind: "error", text: String(error) } }));
