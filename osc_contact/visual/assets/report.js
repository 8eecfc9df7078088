"use strict";
// The folded scene becomes a page of its own when it is opened for the first time.

async function unfold() {
  const text = document.getElementById("packed").textContent;
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const frame = document.createElement("iframe");
  frame.title = "moving scene of the run";
  frame.srcdoc = await new Response(stream).text();
  document.getElementById("stage").appendChild(frame);
}

const scene = document.getElementById("scene");
if (scene) scene.addEventListener("toggle", unfold, { once: true });
