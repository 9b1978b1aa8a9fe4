// The trace of a path: the line on which the tool moves, where it is when it is deflected, and faded ellipsoids along it.
"use strict";

hasWebGL && (() => {
  const { viewer, node, on } = pm3dof;
  const { THREE } = MeshCat;
  const LINE = 0x1f6fb2, BEYOND = 0xc8102e, DEFLECTED = 0xd55e00, OPACITY = 0.05; // of an ellipsoid
  const COUNT = 8; // ellipsoids along the path
  const SIDES = 8, THICKNESS = 0.007; // of the line, in half diagonals of the machine's box

  const traceEntry = () => pm3dof.panel().legend.find(({ key }) => key === "trace");

  function clear(path) {
    const { object } = node(path);
    object.children.forEach(({ geometry }) => geometry.dispose());
    object.clear();
    return object;
  }

  // A tube through points, each with a colour; the tube has that of the nearest one.
  function tube(places, colours, thickness, size) {
    const points = places.map((place) => new THREE.Vector3(...place));
    const kept = points.map((_, k) => k).filter((k) => !k || points[k].distanceTo(points[k - 1]) > 1e-6 * size);
    if (kept.length < 2) return null; // the tool stays where it is
    const curve = new THREE.CatmullRomCurve3(kept.map((k) => points[k]));
    const geometry = new THREE.TubeGeometry(curve, 4 * kept.length, thickness * size, SIDES);
    const around = geometry.getAttribute("position"), made = new Float32Array(3 * around.count), at = new THREE.Vector3();
    for (let index = 0; index < around.count; index++) {
      at.fromBufferAttribute(around, index);
      const nearest = kept.reduce((best, k) => at.distanceToSquared(points[k]) < at.distanceToSquared(points[best]) ? k : best);
      new THREE.Color(colours[nearest]).toArray(made, 3 * index);
    }
    geometry.setAttribute("color", new THREE.BufferAttribute(made, 3));
    const line = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ vertexColors: true, depthTest: false, transparent: true }));
    line.renderOrder = 1; // after the ellipsoids around it
    return line;
  }

  function drawLine(path, poses, { frames, deflected }) {
    const holder = clear(path), { box: [low, high] } = pm3dof.panel().camera;
    const size = 0.5 * Math.hypot(...high.map((entry, index) => entry - low[index]));
    const tools = poses.map((pose) => [...pose.tool]);
    const lines = [tube(tools, frames.map(({ within }) => within ? LINE : BEYOND), THICKNESS, size)];
    if (deflected) {
      const moved = tools.map((tool, k) => tool.map((entry, index) => entry + deflected[k][index]));
      lines.push(tube(moved, moved.map(() => DEFLECTED), 0.5 * THICKNESS, size));
    }
    lines.filter(Boolean).forEach((line) => holder.add(line));
  }

  // The first ellipsoid of the legend at some poses.
  function drawTrail(path, poses) {
    const holder = clear(path), robot = pm3dof.robot();
    const entry = pm3dof.panel().legend.find(({ live }) => live && live.kind === "ellipsoid");
    if (!entry) return;
    const material = new THREE.MeshBasicMaterial({ color: entry.colour, transparent: true, opacity: OPACITY, depthWrite: false });
    const last = poses.length - 1, places = Array.from({ length: COUNT }, (_, k) => Math.round(last * k / (COUNT - 1)));
    [...new Set(places)].forEach((place) => {
      const pose = poses[place], found = robot.ellipsoid(pose, entry.live, robot.compliance(pose));
      if (typeof found === "string") return;
      const greatest = Math.max(...found.values.map(Math.abs));
      if (!(greatest * entry.live.scale < 4 * entry.live.length)) return; // near a singular pose it would hide the machine
      const lengths = found.values.map((value) => entry.live.scale * Math.max(Math.abs(value), 1e-6 * greatest));
      const ball = new THREE.Mesh(new THREE.SphereGeometry(1, 24, 16), material);
      ball.matrixAutoUpdate = false;
      ball.matrix.fromArray(Robot.stretched(found.axes, lengths, pose.tool));
      holder.add(ball);
    });
  }

  function build() {
    const entry = traceEntry(), { path } = pm3dof.panel(), robot = pm3dof.robot();
    if (!entry || !path || !robot || robot.data.tool === null) return;
    const poses = path.frames.map(({ q }) => robot.pose(q));
    drawLine(entry.nodes[0], poses, path);
    drawTrail(entry.nodes[1], poses);
    viewer.set_dirty();
  }

  on("panel", build);
  on("choice", build);
})();
