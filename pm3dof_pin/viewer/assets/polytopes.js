// Polytopes of the tool's forces and speeds within the drives' limits, kept up with the sliders.
"use strict";

const Polytope = (() => {
  const FLAT = 1e-12; // squared, relative to the greatest: directions in which the tool does not move
  const SAME = 1e-9; // relative distance of planes that are one

  const dot = (a, b) => a.reduce((sum, entry, index) => sum + entry * b[index], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const size = (a) => Math.sqrt(dot(a, a));
  const sum = (a, b, factor) => a.map((entry, index) => entry + factor * b[index]);

  // A slab low <= n x <= high of all x with low <= a x <= high, for a of any length; null if it holds everything.
  function slab(normal, low, high) {
    const length = size(normal);
    if (length > 0) return { normal: normal.map((entry) => entry / length), low: low / length, high: high / length };
    if (low > 0 || high < 0) throw "the drives cannot hold the weight";
    return null;
  }

  // Forces f with |T'f + h| <= limits, for columns t of T: motions of the tool by each drive, and what holds the weight.
  function forces(columns, limits, holding) {
    return columns.map((t, k) => slab(t, -limits[k] - holding[k], limits[k] - holding[k])).filter(Boolean);
  }

  // Speeds T c with |c| <= limits: between planes through all columns but one, in as many dimensions as they span.
  function speeds(columns, limits, axes) {
    const reach = (normal) => columns.reduce((total, t, k) => total + limits[k] * Math.abs(dot(normal, t)), 0);
    const greatest = Math.max(...columns.map(size)), normals = [];
    if (axes.length === 1) normals.push(axes[0]);
    columns.forEach((a, i) => {
      if (axes.length === 2) normals.push(cross(cross(axes[0], axes[1]), a));
      if (axes.length === 3) columns.slice(i + 1).forEach((b) => normals.push(cross(a, b)));
    });
    const least = SAME * greatest ** (axes.length - 1);
    return normals.filter((normal) => size(normal) > least).map((normal) => slab(normal, -reach(normal), reach(normal)));
  }

  // The axes of the space that columns span.
  function spanned(columns) {
    const gram = [0, 1, 2].map((i) => [0, 1, 2].map((j) => columns.reduce((total, t) => total + t[i] * t[j], 0)));
    const { values, axes } = Robot.principal(gram);
    return [2, 1, 0].filter((k) => values[k] > FLAT * values[2]).map((k) => axes.map((row) => row[k]));
  }

  // The part of a polygon, by its corners in order, on one side of a plane: n x <= b.
  function cut(corners, normal, offset) {
    return corners.flatMap((a, k) => {
      const b = corners[(k + 1) % corners.length], [above, beside] = [a, b].map((point) => dot(normal, point) - offset);
      const kept = above <= 0 ? [a] : [];
      if ((above < 0 && beside > 0) || (above > 0 && beside < 0)) kept.push(sum(a, sum(b, a, -1), above / (above - beside)));
      return kept;
    });
  }

  // Faces, by their corners in order, of the part of a space that slabs hold; one of a polygon, or of two ends.
  function faces(slabs, axes) {
    const matrix = axes.map((a) => axes.map((b) => slabs.reduce((total, { normal }) => total + dot(normal, a) * dot(normal, b), 0)));
    const least = Math.min(...Robot.eigen(matrix).values);
    const far = 2 * Math.sqrt(slabs.length / least) * Math.max(...slabs.flatMap(({ low, high }) => [Math.abs(low), Math.abs(high)]));
    const planes = slabs.flatMap(({ normal, low, high }) => [[normal, high], [normal.map((entry) => -entry), -low]]);
    const square = (origin, [u, v]) => [[1, 1], [-1, 1], [-1, -1], [1, -1]].map(([a, b]) => sum(sum(origin, u, a * far), v, b * far));
    if (axes.length === 1) {
      const signs = planes.map(([normal, offset]) => [dot(normal, axes[0]), offset]);
      const high = Math.min(...signs.filter(([sign]) => sign > 0).map(([sign, offset]) => offset / sign));
      const low = Math.max(...signs.filter(([sign]) => sign < 0).map(([sign, offset]) => offset / sign));
      return low <= high ? [[low, high].map((end) => axes[0].map((entry) => end * entry))] : [];
    }
    if (axes.length === 2) {
      const corners = planes.reduce((rest, [normal, offset]) => cut(rest, normal, offset), square([0, 0, 0], axes));
      return corners.length > 2 ? [corners] : [];
    }
    return planes.map(([normal, offset], index) => {
      const turn = Robot.turnZTo(normal), sides = [0, 1].map((column) => turn.map((row) => row[column]));
      let corners = square(normal.map((entry) => offset * entry), sides);
      planes.forEach(([other, end], k) => {
        const same = dot(normal, other) > 1 - SAME && Math.abs(end - offset) <= SAME * far;
        if (k === index || !corners.length || (same && k > index)) return;
        corners = same ? [] : cut(corners, other, end); // of planes that are one, the first is the face
      });
      return corners.filter((corner, k) => size(sum(corner, corners[(k + 1) % corners.length], -1)) > SAME * far);
    }).filter((corners) => corners.length > 2);
  }

  // Faces of a polytope at a pose, and the least and greatest of it in any direction that the tool moves in.
  function at(robot, pose, { of, motion, drives }) {
    const motions = robot.motions(pose);
    if (!motions) throw "not in this pose: near a singular one";
    const rows = motions.commands.slice(...(motion === "translation" ? [0, 3] : [3, 6]));
    const columns = drives.map(({ command, scale }) => rows.map((row) => scale * row[command]));
    const limits = drives.map(({ limit }) => limit), axes = spanned(columns);
    const held = of === "force" ? robot.holdingForces(pose) : null;
    if (of === "force" && !held) throw "no forces hold this singular pose";
    const slabs = of === "force" ? forces(columns, limits, drives.map(({ actuator }) => held[actuator])) : speeds(columns, limits, axes);
    const found = faces(slabs, axes), corners = found.flat();
    if (!corners.length) throw "the drives cannot hold the weight";
    const least = Math.min(...slabs.flatMap(({ low, high }) => [-low, high]));
    return { faces: found, values: [Math.max(0, least), Math.max(...corners.map(size))] };
  }

  return { at };
})();

hasWebGL && (() => {
  const { THREE } = MeshCat;
  const { node, placeNode, engineering, setValues, fittingScale, isShown } = pm3dof;

  function setPoints(path, points) {
    const { object } = node(`${path}/<object>`);
    object.geometry.dispose();
    object.geometry = new THREE.BufferGeometry().setFromPoints(points.map((point) => new THREE.Vector3(...point)));
  }

  function follow(entry) {
    if (!isShown(entry)) return setValues(entry, "");
    const { faces, values } = Polytope.at(pm3dof.robot(), pm3dof.pose(), entry.live);
    const scale = fittingScale(entry, values[1], "length");
    const drawn = faces.map((corners) => corners.map((corner) => corner.map((number) => scale * number)));
    const triangles = drawn.flatMap((corners) => corners.slice(2).flatMap((corner, k) => [corners[0], corners[k + 1], corner]));
    setPoints(`${entry.nodes[0]}/surface`, triangles);
    setPoints(`${entry.nodes[0]}/edges`, drawn.flatMap((corners) => corners.flatMap((corner, k) => [corner, corners[(k + 1) % corners.length]])));
    placeNode(entry.nodes[0], [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, ...pm3dof.pose().tool, 1]);
    setValues(entry, engineering(values, entry.live.unit));
  }

  pm3dof.followers.polytope = follow;
})();
