"use strict";
// A folded scene becomes a separate page when it is opened for the first time.

async function unfold(details) {
  const text = details.nextElementSibling.textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const frame = document.createElement("iframe");
  frame.title = details.querySelector("summary").textContent;
  frame.srcdoc = await new Response(stream).text();
  details.querySelector("div").appendChild(frame);
}

for (const details of document.querySelectorAll("details.scene")) {
  details.addEventListener("toggle", () => unfold(details), { once: true });
}
