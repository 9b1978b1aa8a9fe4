// The load at the tool: arrows, of which the force can be dragged, and the tool's body where the load takes it.
"use strict";

hasWebGL && (() => {
  const { viewer, Ghost, placeNode, engineering, lineOf, setValues, on, project, roundScale, isShown } = pm3dof;
  const { THREE } = MeshCat;
  const COLOUR = 0x00805a, OPACITY = 0.38;
  const LEAST = 0.08, GREATEST = 0.9; // drawn deflections, in lengths of an arrow, at which the magnification changes
  const NEAR = 18; // pixels: the tip is taken this near to it
  const WIDTH = 0.05; // half width of an arrow, in its usual lengths
  const pane = document.getElementById("meshcat-pane");
  const ROUNDING = 1e-9; // of a motion beside the other, times the length of an arrow
  const ray = new THREE.Raycaster();
  let ghost = null, magnification = null, scales = null, plane = null;

  const loadEntry = () => pm3dof.panel().legend.find(({ live }) => live && live.kind === "load");
  const size = (values) => Math.hypot(...values);

  // Lengths of the arrows for one newton and one newton metre, kept while the arrow is dragged.
  function arrowScales({ wrench, length }) {
    const fits = (part, scale) => scale && size(part) * scale < 2.5 * length && size(part) * scale > 0.1 * length;
    return [wrench.slice(0, 3), wrench.slice(3)].map((part, k) => {
      if (!size(part) || plane) return scales ? scales[k] : length;
      return fits(part, scales && scales[k]) ? scales[k] : roundScale(size(part), length);
    });
  }

  // The greatest factor, 1, 2 or 5 times a power of ten, at which the deflection fits into the picture.
  function magnify([v, w], length) {
    const drawn = Math.max(size(v), size(w) * length);
    if (!(drawn > 0)) return 1;
    const fits = magnification && drawn * magnification < GREATEST * length && drawn * magnification > LEAST * length;
    if (fits) return magnification;
    const power = 10 ** Math.floor(Math.log10(0.35 * length / drawn));
    return [5, 2, 1].map((factor) => factor * power).find((factor) => factor * drawn <= 0.35 * length * (1 + 1e-9));
  }

  function drawArrow(path, values, scale, length, origin) {
    const long = size(values) * scale, slim = Math.min(WIDTH * length, 0.5 * long);
    const sizes = long > 0 ? [slim, slim, long] : [1e-9, 1e-9, 1e-9];
    placeNode(path, Robot.stretched(Robot.turnZTo(long > 0 ? values : [0, 0, 1]), sizes, origin));
  }

  function followLoad(entry, compliance) {
    const { live } = entry, { wrench, length } = live, pose = pm3dof.pose(), at = pose.tool;
    if (!compliance) throw "no stiffness in this pose";
    const twist = Robot.apply(compliance, wrench), [v, w] = [twist.slice(0, 3), twist.slice(3)];
    const parts = [size(v) > ROUNDING * size(w) * length ? v : [0, 0, 0], size(w) * length > ROUNDING * size(v) ? w : [0, 0, 0]];
    if (!twist.every(Number.isFinite)) throw "some motion under this load is not held by any spring";
    scales = arrowScales(live);
    magnification = magnify(parts, length);
    entry.nodes.slice(0, 2).forEach((path, k) => drawArrow(path, wrench.slice(3 * k, 3 * k + 3), scales[k], length, at));
    if (ghost) {
      const [shift, turn] = parts.map((part) => part.map((number) => number * magnification)), angle = size(turn);
      const axis = angle ? new THREE.Vector3(...turn.map((number) => number / angle)) : new THREE.Vector3(0, 0, 1);
      const moved = new THREE.Matrix4().makeRotationAxis(axis, angle).setPosition(...at.map((number, i) => number + shift[i]));
      ghost.place(pose, moved.multiply(new THREE.Matrix4().makeTranslation(...at.map((number) => -number))));
    }
    const loads = [["N", wrench.slice(0, 3), scales[0]], ["N m", wrench.slice(3), scales[1]]].filter(([, part]) => size(part));
    lineOf(entry, "line").textContent = loads.map(([unit, , scale]) => `arrow of ${Number((1000 * length).toPrecision(6))} mm = ${engineering(length / scale, unit, 4)}`).join(", ");
    const drawn = ghost ? `\ndrawn ${magnification.toLocaleString("en")} times as large` : "";
    setValues(entry, `${loads.map(([unit, part]) => engineering(size(part), unit)).join(", ")}: ${engineering(size(parts[0]), "m")}, ${engineering(size(parts[1]), "rad")}${drawn}`);
  }

  // ------------------------------------------------------------------------------------- the arrow dragged

  // The tip of the force, where the machine is shown with one.
  function tip() {
    const entry = loadEntry();
    if (!entry || entry.stale || !isShown(entry) || !scales || !size(entry.live.wrench.slice(0, 3))) return null;
    return pm3dof.pose().tool.map((number, i) => number + entry.live.wrench[i] * scales[0]);
  }

  function isAtTip({ clientX, clientY, target }) {
    const at = target === viewer.renderer.domElement && tip(), place = at && project(at);
    if (!place) return false;
    const box = pane.getBoundingClientRect();
    return Math.hypot(place[0] + box.left - clientX, place[1] + box.top - clientY) < NEAR;
  }

  // The part of a force in the machine's plane, if it has one.
  function inSpace(force) {
    const { basis, translations } = pm3dof.robot().data, axes = basis.slice(0, translations).map((axis) => axis.slice(0, 3));
    if (translations === 3) return force;
    return [0, 1, 2].map((i) => axes.reduce((sum, axis) => sum + axis[i] * axis.reduce((inner, entry, k) => inner + entry * force[k], 0), 0));
  }

  function take(event) {
    if (event.button !== 0 || !isAtTip(event)) return;
    const normal = viewer.camera.getWorldDirection(new THREE.Vector3());
    const at = viewer.scene.localToWorld(new THREE.Vector3(...tip()));
    plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, at);
    viewer.controls.enabled = false;
    event.stopImmediatePropagation(); // not a body
  }

  function pull(event) {
    if (!plane) {
      pane.classList.toggle("at-tip", !event.buttons && isAtTip(event));
      return;
    }
    const box = pane.getBoundingClientRect();
    const at = new THREE.Vector2((event.clientX - box.left) / box.width * 2 - 1, 1 - (event.clientY - box.top) / box.height * 2);
    ray.setFromCamera(at, viewer.camera);
    const point = ray.ray.intersectPlane(plane, new THREE.Vector3()), { live } = loadEntry();
    if (!point) return;
    const tool = pm3dof.pose().tool, force = inSpace(viewer.scene.worldToLocal(point).toArray().map((number, i) => (number - tool[i]) / scales[0]));
    if (size(force) * scales[0] < 0.02 * live.length) return; // a load of zero has no arrow to take
    const round = 10 ** (Math.floor(Math.log10(size(force))) - 2);
    pm3dof.load([...force.map((number) => Number((Math.round(number / round) * round).toPrecision(6))), ...live.wrench.slice(3)]);
  }

  function release() {
    if (!plane) return;
    plane = null;
    viewer.controls.enabled = true;
  }

  function build() {
    const entry = loadEntry(), robot = pm3dof.robot();
    ghost = null;
    if (!entry || !robot) return;
    const bodies = robot.data.bodies.filter(({ joint }) => joint && joint === robot.data.tool_joint);
    ghost = bodies.length ? new Ghost(entry.nodes[2], bodies, COLOUR, OPACITY) : null;
    pm3dof.update(entry);
  }

  pm3dof.followers.load = followLoad;
  pane.addEventListener("pointerdown", take, true);
  window.addEventListener("pointermove", pull);
  window.addEventListener("pointerup", release);
  window.addEventListener("pointercancel", release);
  on("panel", build);
  Object.assign(pm3dof, { loadTip: () => { const at = tip(); return at && project(at); }, magnification: () => magnification });
})();
