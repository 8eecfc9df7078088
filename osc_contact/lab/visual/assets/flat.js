"use strict";
// Without WebGL: a still picture of each instant, its triangles drawn on a plain canvas.

function facesOf(object, view, w, h, faces) {
  const { position, color } = object.geometry.attributes, index = object.geometry.index;
  const material = [object.material].flat()[0], corners = object.isMesh ? 3 : 2;
  const count = index ? index.count : position.count, step = object.isLine && !object.isLineSegments ? 1 : corners;
  const world = (i) => new MeshCat.THREE.Vector3().fromBufferAttribute(position, i).applyMatrix4(object.matrixWorld);
  for (let first = 0; first + corners <= count; first += step) {
    const at = [...Array(corners).keys()].map((k) => (index ? index.getX(first + k) : first + k));
    const places = at.map(world);
    const seen = places.map((place) => place.clone().applyMatrix4(view));
    if (seen.some((point) => Math.abs(point.z) > 1)) continue;
    let light = 1;
    if (corners === 3) {
      const normal = places[1].clone().sub(places[0]).cross(places[2].clone().sub(places[0])).normalize();
      light = 0.62 + 0.38 * Math.abs(0.4 * normal.x + 0.8 * normal.y + 0.45 * normal.z);
    }
    const own = material.vertexColors && color;
    const { r, g, b } = own ? { r: color.getX(at[0]), g: color.getY(at[0]), b: color.getZ(at[0]) } : material.color;
    faces.push({
      depth: Math.max(...seen.map((point) => point.z)),
      points: seen.map((point) => [0.5 * (point.x + 1) * w, 0.5 * (1 - point.y) * h]),
      colour: `rgba(${[r, g, b].map((x) => Math.round(255 * light * x))}, ${material.transparent ? material.opacity : 1})`,
    });
  }
}

class FlatRenderer { // in the place of three.js's
  constructor(box) {
    this.domElement = box.appendChild(document.createElement("canvas"));
    this.pen = this.domElement.getContext("2d");
    const note = box.appendChild(document.createElement("p"));
    note.id = "flat";
    note.textContent = "This browser has no WebGL: here are still pictures, one for each time of the slider. " +
      "Switch on hardware acceleration, or open the page in another browser, for the moving scene.";
  }

  setPixelRatio(ratio) { this.ratio = ratio; }

  setSize(w, h) {
    Object.assign(this.domElement, { width: w * this.ratio, height: h * this.ratio });
    Object.assign(this.domElement.style, { width: `${w}px`, height: `${h}px` });
  }

  render(scene, camera) {
    const { width, height } = this.domElement, pen = this.pen, faces = [];
    scene.updateMatrixWorld();
    camera.updateMatrixWorld();
    const view = camera.projectionMatrix.clone().multiply(camera.matrixWorldInverse);
    scene.traverseVisible((object) => {
      if ((object.isMesh || object.isLine) && object.geometry.attributes.position) {
        facesOf(object, view, width, height, faces);
      }
    });
    pen.clearRect(0, 0, width, height);
    pen.lineJoin = "round";
    for (const { points, colour } of faces.sort((a, b) => b.depth - a.depth)) { // the farthest first
      pen.fillStyle = pen.strokeStyle = colour;
      pen.beginPath();
      for (const point of points) pen.lineTo(...point);
      pen.closePath();
      pen.fill();
      pen.stroke(); // no gaps between neighbours
    }
  }
}

const hasWebGL = () => ["webgl2", "webgl"].some((kind) => document.createElement("canvas").getContext(kind));
