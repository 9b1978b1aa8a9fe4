// The pointer: texts about the body under it, and bodies dragged with the machine.
"use strict";

hasWebGL && (() => {
  const { viewer, node, element, engineering, fixed } = pm3dof;
  const { THREE } = MeshCat;
  const pane = document.getElementById("meshcat-pane"), tip = document.getElementById("tip");
  const ROUNDS = 4; // steps towards the pointer per pointer event
  const ray = new THREE.Raycaster();
  let grip = null; // what is dragged: joint, point in the joint frame, plane of motion

  function aim({ clientX, clientY }) {
    const box = pane.getBoundingClientRect();
    const at = new THREE.Vector2((clientX - box.left) / box.width * 2 - 1, 1 - (clientY - box.top) / box.height * 2);
    ray.setFromCamera(at, viewer.camera);
  }

  // The body under the pointer and the point on it, in three.js world coordinates.
  function hit(event) {
    const robot = pm3dof.robot();
    if (!robot) return null;
    aim(event);
    for (const { object, point } of ray.intersectObject(node("/robot").object, true)) {
      for (let at = object; at; at = at.parent) {
        const body = robot.data.bodies.find(({ path }) => node(path).object === at);
        if (body) return { body, point };
      }
    }
    return null;
  }

  // Lines about a body at the displayed pose.
  function about(body) {
    const robot = pm3dof.robot(), pose = pm3dof.pose(), lines = [...body.about];
    if (body.actuator !== null && robot.data.commands.length) {
      const number = robot.data.commands[body.actuator];
      const [value] = pose.values({ numbers: [number] });
      const { factor, digits, unit, range } = number.slider, written = (one) => fixed(one * factor, digits);
      lines.push(`${number.name} ${written(value)}${range ? ` of ${range.map(written).join(" to ")}` : ""}${unit}`);
      const forces = robot.holdingForces(pose);
      if (forces) lines.push(`holds the weight with ${engineering(forces[body.actuator], robot.data.actuators[body.actuator].unit)}`);
    }
    const shares = pm3dof.panel().legend.find(({ live }) => live && live.kind === "shares");
    const painted = shares && shares.paint.find(({ path }) => path.startsWith(`${body.path}/`));
    if (painted && robot.compliance(pose)) {
      const [share] = robot.shares(pose, [shares.live.springs[painted.leg]], shares.live.wrench);
      if (Number.isFinite(share)) lines.push(`its leg contributes ${fixed(100 * share, 1)} % of the deflection under the load`);
    }
    return lines;
  }

  function explain(event) {
    const found = event.buttons || event.target !== viewer.renderer.domElement ? null : hit(event);
    tip.hidden = !found;
    pane.style.cursor = found && found.body.joint ? "grab" : "";
    if (!found) return;
    tip.textContent = "";
    element(tip, "b", "", found.body.name);
    about(found.body).forEach((line) => element(tip, "div", "", line));
    const place = (at, size, most, [near, far]) => (at + most > size ? `${far}:${size - at + 12}px;` : `${near}:${at + 12}px;`);
    tip.style.cssText = place(event.clientX, window.innerWidth, 260, ["left", "right"]) + place(event.clientY, window.innerHeight, 170, ["top", "bottom"]);
  }

  function take(event) {
    if (event.button !== 0 || event.target !== viewer.renderer.domElement) return;
    const found = hit(event);
    if (!found || !found.body.joint || !pm3dof.set()) return;
    const normal = viewer.camera.getWorldDirection(new THREE.Vector3());
    const [x, y, z] = viewer.scene.worldToLocal(found.point.clone()).toArray();
    const rows = pm3dof.pose().rows(found.body.joint), from = [x, y, z].map((entry, i) => entry - rows[i][3]);
    const local = [0, 1, 2].map((column) => rows.reduce((sum, row, i) => sum + row[column] * from[i], 0));
    grip = { joint: found.body.joint, local, plane: new THREE.Plane().setFromNormalAndCoplanarPoint(normal, found.point) };
    viewer.controls.enabled = false;
    pane.style.cursor = "grabbing";
    tip.hidden = true;
    event.stopPropagation();
  }

  function pull(event) {
    if (!grip) return explain(event);
    aim(event);
    const point = ray.ray.intersectPlane(grip.plane, new THREE.Vector3());
    if (point) drag(grip.joint, grip.local, viewer.scene.worldToLocal(point).toArray());
  }

  // Bring a point of a joint's body as near to a target as the robot permits [m].
  function drag(joint, local, target) {
    const robot = pm3dof.robot();
    let pose = pm3dof.pose();
    for (let round = 0; round < ROUNDS; round++) {
      const next = robot.pulled(pose, robot.data.sets[0], joint, local, target);
      if (!next) break;
      pose = next;
    }
    if (pose !== pm3dof.pose()) pm3dof.show(pose);
  }

  function release() {
    if (!grip) return;
    grip = null;
    viewer.controls.enabled = true;
    pane.style.cursor = "";
  }

  pane.addEventListener("pointerdown", take, true);
  window.addEventListener("pointermove", pull);
  window.addEventListener("pointerup", release);
  window.addEventListener("pointercancel", release);
  pane.addEventListener("pointerleave", () => { tip.hidden = true; });
  Object.assign(pm3dof, { drag, bodyAt: (x, y) => { const found = hit({ clientX: x, clientY: y }); return found && found.body.name; } });
})();
