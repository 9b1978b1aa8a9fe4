// The page around meshcat's: feeds it the scene, draws the panel, and moves the machine when a slider moves.
"use strict";

const pm3dof = (() => {
  const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
  const FIELD_OF_VIEW = 30; // degrees: little perspective, as in a technical drawing
  const shown = new Map(); // what the reader ticked, by entry
  let panel = {};
  let machine = null; // ClosedForm.Tripod, where the mechanism is one
  let pose = null;
  let cameraSerial = null;
  let pathTime = null;

  // ---------------------------------------------------------------------------------------------- scene

  const split = (path) => path.split("/").filter((name) => name.length > 0);
  const node = (path) => viewer.scene_tree.find(split(path));
  const placeNode = (path, matrix) => node(path).set_transform(matrix);

  // Arrays that came as base64 become typed arrays.
  function unpacked(value) {
    if (Array.isArray(value)) return value.map(unpacked);
    if (value === null || typeof value !== "object") return value;
    if ("base64" in value) {
      const bytes = Uint8Array.from(atob(value.base64), (character) => character.charCodeAt(0));
      return new window[value.typed_array](bytes.buffer);
    }
    return Object.fromEntries(Object.entries(value).map(([key, entry]) => [key, unpacked(entry)]));
  }

  function receive(message) {
    for (const command of message.commands || []) viewer.handle_command(unpacked(command));
    if ((message.commands || []).some((command) => command.type === "set_control")) tidyControls();
    if (message.panel) showPanel(message.panel);
    viewer.set_dirty();
  }

  // Sliders and buttons first, meshcat's own folders closed below them.
  function tidyControls() {
    const list = viewer.gui.__ul;
    const own = Object.values(viewer.gui_controllers).map((controller) => controller.__li);
    own.reverse().forEach((item) => list.insertBefore(item, list.firstChild));
    viewer.gui.width = 300;
    viewer.gui.__folders.Scene.close();
    viewer.gui.open();
  }

  // Look at a box from a direction so that it just fills the picture, with some room for panel and controls; nearer by
  // the closeness, unless points would then be outside.
  function frame({ box: [low, high], points, azimuth, elevation, closeness, serial }) {
    if (serial === cameraSerial) return;
    cameraSerial = serial;
    const [a, e] = [azimuth, elevation].map((angle) => angle * Math.PI / 180);
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    const along = (p, direction) => p[0] * direction[0] + p[1] * direction[1] + p[2] * direction[2];
    const target = low.map((entry, index) => 0.5 * (entry + high[index]));
    const room = Math.max(0.55, 1 - 330 / window.innerWidth);
    const half = Math.tan(FIELD_OF_VIEW * Math.PI / 360), aspect = window.innerWidth / window.innerHeight;
    // from where a point is still in a part of the picture
    const distanceOf = (point, width, height) => {
      const p = point.map((entry, index) => entry - target[index]);
      const reach = Math.max(Math.abs(along(p, right)) / (width * aspect), Math.abs(along(p, up)) / height);
      return reach / half + along(p, back);
    };
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((c) => target.map((_, index) => ((c >> index) & 1 ? high : low)[index]));
    const distance = Math.max(
      ...corners.map((corner) => distanceOf(corner, 0.88 * room, 0.88) / closeness),
      ...points.map((point) => distanceOf(point, 0.97, 0.97)),
    );
    const radius = 0.5 * Math.hypot(...high.map((entry, index) => entry - low[index]));
    const eye = back.map((entry, index) => target[index] + distance * entry);
    const camera = viewer.camera; // three.js holds y up here
    camera.fov = FIELD_OF_VIEW;
    camera.near = radius / 50;
    camera.far = 60 * radius;
    camera.position.set(eye[0], eye[2], -eye[1]);
    viewer.controls.target.set(target[0], target[2], -target[1]);
    viewer.set_dirty();
  }

  // ---------------------------------------------------------------------------------------------- panel

  const scientific = (number) => {
    const [mantissa, exponent] = number.toExponential(2).split("e");
    return Math.abs(exponent) < 3 ? String(Number(number.toPrecision(3))) : `${mantissa}e${Number(exponent)}`;
  };

  // Zero has no sign.
  const fixed = (number, digits) => number.toFixed(digits).replace(/^-(?=[0.]*$)/, "");

  function element(parent, tag, name, text) {
    const made = parent.appendChild(document.createElement(tag));
    if (name) made.className = name;
    if (text !== undefined) made.textContent = text;
    return made;
  }

  function isShown(entry) {
    return shown.has(entry.key) ? shown.get(entry.key) : entry.visible;
  }

  function showPanel(data) {
    panel = data;
    document.title = data.title;
    document.querySelector("h1").textContent = data.title;
    document.getElementById("subtitle").textContent = data.subtitle || "";
    const legend = document.getElementById("legend");
    legend.textContent = "";
    data.legend.forEach((entry) => legend.append(entryElement(entry)));
    if (data.camera) frame(data.camera);
    machine = data.machine ? new ClosedForm.Tripod(data.machine) : null;
    pose = data.pose ? data.pose.slice() : null;
    data.legend.forEach(applyEntry);
    showNote(data.note || [], data.warnings || []);
  }

  function entryElement(entry) {
    const made = document.createElement("div");
    made.className = "entry";
    made.dataset.key = entry.key;
    const label = element(made, "label");
    const box = element(label, "input");
    box.type = "checkbox";
    box.checked = isShown(entry);
    box.addEventListener("change", () => {
      shown.set(entry.key, box.checked);
      applyEntry(entry);
      viewer.set_dirty();
    });
    if (entry.colour) element(label, "span", "swatch").style.background = entry.colour;
    element(label, "span", "", entry.title);
    element(made, "div", "values", entry.values || "");
    entry.lines.forEach((line) => element(made, "div", "line", line.replaceAll("N m", "N\u00a0m"))); // not torn apart
    if (entry.bar) {
      element(made, "div", "bar").style.background = `linear-gradient(to right, ${entry.bar.colours.join(", ")})`;
      const ends = element(made, "div", "ends");
      entry.bar.ends.forEach((end) => element(ends, "span", "", end));
    }
    return made;
  }

  function setValues(entry, text) {
    document.querySelector(`.entry[data-key="${entry.key}"] .values`).textContent = text;
  }

  // Show, hide or paint what an entry of the legend stands for.
  function applyEntry(entry) {
    const visible = isShown(entry);
    entry.nodes.forEach((path) => { node(path).object.visible = visible && !entry.stale; });
    if (entry.paint) {
      entry.paint.forEach(({ path, own, colour }) => {
        node(path).set_property("color", visible && !entry.stale ? [...colour, own[3]] : own);
      });
    }
  }

  function showNote(lines, warnings = []) {
    const note = document.getElementById("note");
    note.textContent = "";
    lines.forEach((line, index) => element(note, "p", index ? "faint" : "", line));
    warnings.forEach((line) => element(note, "p", "warning", line));
  }

  // -------------------------------------------------------------------------------------------- sliders

  function slide(index, value) {
    const wanted = pose.slice();
    wanted[index] = value;
    move(wanted);
  }

  function home() {
    pose = panel.machine.home.slice();
    setSliders();
    move(pose);
  }

  function setSliders() {
    const values = [ClosedForm.degrees(pose[0]), ClosedForm.degrees(pose[1]), pose[2]];
    panel.machine.sliders.forEach((name, index) => viewer.set_control_value(name, values[index], false));
  }

  function move(wanted) {
    if (viewer.animator.playing) viewer.animator.pause();
    pose = wanted;
    const [x, y, z] = [fixed(ClosedForm.degrees(pose[0]), 1), fixed(ClosedForm.degrees(pose[1]), 1), fixed(pose[2], 4)];
    const where = `θx ${x}°, θy ${y}°, z ${z} m`.replaceAll("-", "\u2212");
    const leg = machine.legOutOfReach(pose);
    if (leg) {
      const reason = `Out of reach: the link of leg ${leg} does not meet its guideway.`;
      showNote([where, "The picture stays at the last pose that was in reach."], [reason]);
      return;
    }
    const placements = machine.jointPlacements(pose);
    panel.machine.bodies.forEach(({ path, joint, placement }) => {
      placeNode(path, ClosedForm.product(placements[joint], placement));
    });
    panel.legend.forEach((entry) => (entry.live ? follow(entry) : leaveBehind(entry)));
    viewer.set_dirty();
    const travels = machine.legs(pose).map(({ travel }) => (1000 * travel).toFixed(2)).join(", ");
    const error = machine.closureError(placements).toExponential(0);
    showNote(
      [where, `sliders at ${travels} mm`, `closed form in this page, loops closed to ${error} m`],
      outsideLimits(machine.brokenLimits(pose)),
    );
  }

  // As outside_limits does in pm3dof_pin/viewer/panel.py.
  function outsideLimits(broken) {
    return broken.length ? ["Out of reach within the limits of the joints:", ...broken] : [];
  }

  // What was computed elsewhere for another pose is not shown at this one.
  function leaveBehind(entry) {
    if (!entry.of_pose) return;
    entry.stale = true;
    setValues(entry, "drawn for another pose: hidden");
    applyEntry(entry);
  }

  function follow(entry) {
    const stiffness = machine.stiffness(pose);
    const tool = [0, 0, pose[2]];
    const forces = entry.live.kind === "forces" ? machine.holdingForces(pose) : null;
    entry.stale = forces ? !forces.every(Number.isFinite) : stiffness === null;
    if (entry.stale) {
      setValues(entry, forces ? "no forces hold this singular pose" : "no stiffness at or below the clamp");
    } else if (entry.live.kind === "ellipsoid") {
      const { values, axes } = ClosedForm.principal(machine.block(stiffness, entry.live));
      placeNode(entry.nodes[0], ClosedForm.stretched(axes, values.map((value) => value * entry.live.scale), tool));
      setValues(entry, values.map(scientific).join(" · ") + ` ${entry.live.unit}`);
    } else if (entry.live.kind === "forces") {
      followForces(entry, forces);
    } else if (entry.live.kind === "shares") {
      followShares(entry, stiffness);
    }
    applyEntry(entry);
  }

  function followForces(entry, forces) {
    const { scale, width } = entry.live;
    machine.legs(pose).forEach(({ leg, guide, travel }, index) => {
      const force = forces[index];
      const direction = guide.map((part) => part * (force < 0 ? -1 : 1));
      const slider = [0, 1, 2].map((part) => leg[part] + travel * guide[part]);
      const length = Math.max(Math.abs(force) * scale, 1e-6 * width), slim = Math.min(width, 0.5 * length);
      placeNode(entry.nodes[index], ClosedForm.stretched(ClosedForm.turnZTo(direction), [slim, slim, length], slider));
    });
    setValues(entry, `${forces.map((force) => fixed(force, 2)).join(", ")} N`);
  }

  function followShares(entry, stiffness) {
    const shares = machine.legShares(pose, stiffness, entry.live.wrench);
    entry.paint.forEach((item) => { item.colour = blend(entry.live.stops, shares[item.leg]); });
    const { names } = entry.live;
    setValues(entry, shares.map((share, leg) => `${names[leg]}: ${(100 * share).toFixed(1)} %`).join("\n"));
  }

  // The colour at a place between 0 and 1 of a list of colours.
  function blend(stops, place) {
    const at = Math.min(1, Math.max(0, place)) * (stops.length - 1);
    const below = Math.min(Math.floor(at), stops.length - 2);
    return stops[below].map((part, index) => part + (at - below) * (stops[below + 1][index] - part));
  }

  // ---------------------------------------------------------------------------------------------- start

  // While a path plays, sliders and numbers follow it.
  function watchPath() {
    requestAnimationFrame(watchPath);
    if (!panel.path || viewer.animator.time === pathTime) return;
    pathTime = viewer.animator.time;
    const { frames, duration } = panel.path;
    const place = Math.round(pathTime / duration * (frames.length - 1));
    const at = frames[Math.min(frames.length - 1, Math.max(0, place))];
    showNote(at.note, at.warnings);
    panel.legend.forEach((entry) => { if (entry.key in at.values) setValues(entry, at.values[entry.key]); });
    if (at.pose) {
      pose = at.pose.slice();
      setSliders();
    }
  }

  function connect() {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}/socket`);
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = () => showNote(["The program that served this page has ended.", "What is shown stays usable."]);
  }

  const start = () => {
    receive(JSON.parse(document.getElementById("scene").textContent));
    watchPath();
    if (document.body.dataset.socket === "yes") connect();
  };

  return { viewer, node, slide, home, receive, start, pose: () => pose, panel: () => panel };
})();

pm3dof.start();
