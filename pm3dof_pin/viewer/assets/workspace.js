// The workspace: the quantity that colours it, its scale in the picture, and a plane that cuts it.
"use strict";

hasWebGL && (() => {
  const { viewer, blend, node, element, lineOf, on, tell } = pm3dof;
  const { THREE } = MeshCat;
  const AXES = ["x", "y", "z"];
  const FADED = 0.3; // of the opacity of ellipsoids beside a workspace
  const scale = document.getElementById("scale");
  const opacities = new Map(); // of the ellipsoids' materials
  const state = { layer: 0, axis: 2, part: 1 }; // kept when the panel changes
  let put = () => {};

  function build() {
    const entry = pm3dof.panel().legend.find(({ cut }) => cut);
    if (!entry) return;
    const { cut } = entry, made = lineOf(entry, "values").parentElement, row = element(made, "div", "cut");
    const layers = element(row, "select");
    cut.layers.forEach(({ name }, index) => { element(layers, "option", "", name).value = index; });
    layers.hidden = cut.layers.length < 2;
    layers.title = "quantity shown by the colours";
    const axis = element(row, "select"), place = element(row, "input");
    AXES.forEach((name, index) => { element(axis, "option", "", `cut ${name}`).value = index; });
    Object.assign(place, { type: "range", min: 0, max: 1, step: 0.005, title: "position of the cut" });
    const apply = () => {
      Object.assign(state, { layer: Number(layers.value), axis: Number(axis.value), part: place.valueAsNumber });
      colour(entry);
      clip(cut);
      tell("entries");
    };
    [layers, axis].forEach((select) => select.addEventListener("change", apply));
    place.addEventListener("input", apply);
    put = () => {
      layers.value = Math.min(state.layer, cut.layers.length - 1);
      axis.value = state.axis;
      place.value = state.part;
      apply();
    };
    put();
  }

  // The scale in the picture, and paler ellipsoids, while the workspace is shown.
  function showScale() {
    const entry = pm3dof.panel().legend.find(({ cut }) => cut), isDrawn = Boolean(entry) && pm3dof.isShown(entry);
    scale.hidden = !isDrawn;
    if (isDrawn) {
      const { title, ends } = entry.cut.layers[state.layer];
      scale.textContent = "";
      element(scale, "div", "", title);
      element(scale, "div", "bar").style.background = `linear-gradient(to right, ${entry.bar.colours.join(", ")})`;
      const row = element(scale, "div", "ends");
      ends.forEach((end) => element(row, "span", "", end));
    }
    pm3dof.panel().legend.filter(({ principal }) => principal).forEach(({ nodes }) => node(nodes[0]).object.traverse(({ material }) => {
      if (!material?.transparent) return;
      if (!opacities.has(material)) opacities.set(material, material.opacity);
      material.opacity = opacities.get(material) * (isDrawn ? FADED : 1);
    }));
  }

  function cutTo(layer, axis, part) {
    if (![layer, axis, part].every(Number.isFinite) || !AXES[axis]) return;
    Object.assign(state, { layer, axis, part });
    put();
  }

  function colour(entry) {
    const { layers, stops, colours } = entry.cut, { title, ends, places } = layers[state.layer];
    const made = lineOf(entry, "values").parentElement, bytes = Uint8Array.from(atob(places.base64), (c) => c.charCodeAt(0));
    made.querySelectorAll(".line")[1].textContent = title;
    made.querySelectorAll(".ends span").forEach((end, index) => { end.textContent = ends[index]; });
    let first = 0;
    colours.forEach((path) => {
      const { geometry } = node(`${path}/<object>`).object;
      if (!geometry) return;
      const { array } = geometry.attributes.color;
      for (let k = 0; k < array.length / 3; k++) {
        array.set(blend(stops, bytes[first + k] / 255), 3 * k);
      }
      first += array.length / 3;
      geometry.attributes.color.needsUpdate = true;
    });
    viewer.set_dirty();
  }

  // Keep what is below a plane normal to an axis of the machine.
  function clip({ corners: [low, high], nodes }) {
    const { axis, part } = state, normal = new THREE.Vector3(), point = new THREE.Vector3();
    normal.setComponent(axis, -1);
    point.setComponent(axis, low[axis] + part * (high[axis] - low[axis]) + (part < 1 ? 0 : 1e3));
    viewer.scene.updateMatrixWorld();
    // the surface hides points inside, which show only where it is cut open
    nodes.filter((path) => path.endsWith("/points")).forEach((path) => { node(path).object.visible = part < 1; });
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, point).applyMatrix4(viewer.scene.matrixWorld);
    viewer.renderer.localClippingEnabled = true;
    nodes.forEach((path) => {
      const { material } = node(`${path}/<object>`).object;
      if (material) Object.assign(material, { clippingPlanes: [plane] });
    });
    viewer.set_dirty();
  }

  on("panel", () => { build(); showScale(); });
  on("entries", showScale);
  Object.assign(pm3dof, { cut: () => ({ ...state }), cutTo });
})();
