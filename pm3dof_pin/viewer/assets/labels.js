// Names in the picture: those behind a nearer one are hidden.
"use strict";

hasWebGL && (() => {
  const { viewer, node, project, isShown, on } = pm3dof;
  const INK = 0.45; // of a label's height and width covered by its letters

  function tidy() {
    const entry = pm3dof.panel().legend.find(({ key }) => key === "labels");
    if (!entry || !isShown(entry)) return;
    const focal = 1 / Math.tan(viewer.camera.fov * Math.PI / 360) / 2 * viewer.renderer.domElement.clientHeight; // pixels
    const placed = entry.nodes.map((path) => {
      const { object } = node(path), point = object.getWorldPosition(new MeshCat.THREE.Vector3());
      const distance = point.distanceTo(viewer.camera.position), at = project(viewer.scene.worldToLocal(point).toArray());
      const size = node(`${path}/<object>`).object.scale;
      return { object, distance, at, half: [size.x, size.y].map((side) => INK * side * focal / distance) };
    });
    const shown = [];
    let changed = false;
    placed.sort((a, b) => a.distance - b.distance).forEach(({ object, at, half }) => {
      const isFree = at !== null && shown.every((other) => [0, 1].some((k) => Math.abs(at[k] - other.at[k]) > (half[k] + other.half[k]) / 2));
      if (isFree) shown.push({ at, half });
      changed ||= object.visible !== isFree;
      object.visible = isFree;
    });
    if (changed) viewer.set_dirty();
  }

  on("picture", tidy);
})();
