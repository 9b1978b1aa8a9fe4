// The page around meshcat's: feeds it the scene, draws the panel, and moves the machine when a slider moves.
"use strict";

const hasWebGL = (() => {
  try {
    return Boolean(document.createElement("canvas").getContext("webgl2"));
  } catch {
    return false;
  }
})();

const pm3dof = hasWebGL && (() => {
  document.body.classList.add("drawn"); // no picture in its place
  const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
  const { fixed } = Robot;
  const NEAR_SINGULAR = 5; // ratio to the motion at home, or its inverse
  const FIELD_OF_VIEW = 30; // degrees; little perspective, as in a technical drawing
  const STOPPED = 0x9b0000; // glow of bodies at a limit
  const AGAIN = 1500; // between attempts to reach a server that has ended [ms]
  const HALVINGS = 7; // of the way to a slider's place out of reach
  const PHONE = 640; // widest window with the panel below the picture, as in page.css [pixels]
  const ROOM = 60; // below the panel for warnings that appear later [pixels]
  const shown = new Map(); // the user's checkboxes, by entry
  let panel = { legend: [] };
  let robot = null; // moved by sliders
  let pose = null; // its displayed pose
  let activeSet = 0; // set of sliders
  let slidersShown = ""; // the existing ones
  let tidied = false;
  let cameraSerial = null;
  let framedFrom = null; // position of the camera
  const listeners = { panel: [], pose: [], entries: [], choice: [], picture: [] };

  // Callbacks of the other parts of the page for a new panel, pose, set of visible entries, option or picture.
  const on = (event, action) => listeners[event].push(action);
  const tell = (event, ...details) => listeners[event].forEach((action) => action(...details));

  // ----------------------------------------------------------------------------------------------- pane

  // Width and height of the picture, and how much of its left and top is behind the panel, zero on a phone, and the
  // buttons [pixels].
  function pane() {
    const { clientWidth: width, clientHeight: height } = document.getElementById("meshcat-pane");
    const bare = document.body.classList.contains("bare"), above = bare ? 0 : document.getElementById("tools").offsetHeight + 8;
    return { width, height, above, behind: bare || height < window.innerHeight ? 0 : Math.min(0.5 * width, 314) };
  }

  // On a phone the picture has the height that the panel leaves, at least 48 %.
  function divide() {
    const { style } = document.documentElement, panel = document.getElementById("panel");
    style.removeProperty("--pane");
    if (window.innerWidth > PHONE) return;
    const box = (each) => each.getBoundingClientRect(), ends = [...panel.children].map((each) => box(each).bottom);
    const needed = Math.max(...ends) - box(panel).top + panel.scrollTop + box(document.getElementById("note")).height;
    const free = window.innerHeight - needed - ROOM;
    style.setProperty("--pane", `${Math.round(Math.min(0.7, Math.max(0.48, free / window.innerHeight)) * window.innerHeight)}px`);
  }

  const setSize = viewer.set_3d_pane_size.bind(viewer);
  viewer.set_3d_pane_size = () => {
    divide();
    const { width, height, behind, above } = pane(), framed = isFramed();
    viewer.camera.setViewOffset(width, height, -0.5 * behind, -0.5 * above, width, height); // centred in the free part
    setSize(width, height);
    if (framed) reframe();
  };

  const render = viewer.render.bind(viewer);
  viewer.render = () => {
    render();
    tell("picture");
  };

  // ---------------------------------------------------------------------------------------------- scene

  const split = (path) => path.split("/").filter((name) => name.length > 0);
  const node = (path) => viewer.scene_tree.find(split(path));
  const placeNode = (path, matrix) => node(path).set_transform(matrix);

  // Turn arrays in base64 into typed arrays.
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
    if (message.panel) showPanel(message.panel);
    viewer.set_dirty();
  }

  function tidyControls() {
    viewer.gui.width = 260;
    viewer.gui.__folders.Scene.close();
  }

  // Look at a box from a direction so that it just fills the picture, with room for panel and controls; closer by the
  // closeness, unless points would then be outside.
  function frame({ box: [low, high], points, azimuth, elevation, closeness, serial }) {
    if (serial === cameraSerial) return;
    cameraSerial = serial;
    const [a, e] = [azimuth, elevation].map((angle) => angle * Math.PI / 180);
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.sin(e) * Math.cos(a), -Math.sin(e) * Math.sin(a), Math.cos(e)];
    const along = (p, direction) => p[0] * direction[0] + p[1] * direction[1] + p[2] * direction[2];
    const target = low.map((entry, index) => 0.5 * (entry + high[index]));
    const { width, height, behind, above } = pane();
    const half = Math.tan(FIELD_OF_VIEW * Math.PI / 360) * (1 - above / height), aspect = (width - behind) / (height - above);
    // the distance at which a point is just inside part of the picture
    const distanceOf = (point, across, upwards) => {
      const p = point.map((entry, index) => entry - target[index]);
      const reach = Math.max(Math.abs(along(p, right)) / (across * aspect), Math.abs(along(p, up)) / upwards);
      return reach / half + along(p, back);
    };
    const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((c) => target.map((_, index) => ((c >> index) & 1 ? high : low)[index]));
    const distance = Math.max(
      ...corners.map((corner) => distanceOf(corner, 0.88, 0.88) / closeness),
      ...points.map((point) => distanceOf(point, 0.97, 0.97)),
    );
    const radius = 0.5 * Math.hypot(...high.map((entry, index) => entry - low[index]));
    const eye = back.map((entry, index) => target[index] + distance * entry);
    const camera = viewer.camera; // three.js has y up here
    camera.fov = FIELD_OF_VIEW;
    camera.near = radius / 50;
    camera.far = 60 * radius;
    camera.position.set(eye[0], eye[2], -eye[1]);
    viewer.controls.target.set(target[0], target[2], -target[1]);
    framedFrom = camera.position.toArray();
    viewer.set_dirty();
  }

  // Whether the camera is where the machine was framed from, and not where the user moved it.
  function isFramed() {
    return framedFrom !== null && viewer.camera.position.toArray().every((entry, k) => Math.abs(entry - framedFrom[k]) < 1e-6 * Math.hypot(...framedFrom));
  }

  function reframe() {
    cameraSerial = null;
    if (panel.camera) frame(panel.camera);
  }

  // Only the machine, on white, in the whole window: for animations.
  function bare() {
    document.body.classList.add("bare");
    viewer.hide_background();
    node("/floor").object.visible = false;
    viewer.set_3d_pane_size();
    reframe();
  }

  // Turn the camera about the vertical through its target [deg].
  function turn(angle) {
    const { position } = viewer.camera, { target } = viewer.controls, a = angle * Math.PI / 180;
    const [x, z] = [position.x - target.x, position.z - target.z];
    position.x = target.x + Math.cos(a) * x + Math.sin(a) * z;
    position.z = target.z - Math.sin(a) * x + Math.cos(a) * z;
    viewer.set_dirty();
  }

  // ---------------------------------------------------------------------------------------------- panel

  const scientific = (number) => {
    const [mantissa, exponent] = number.toExponential(2).split("e");
    return Math.abs(exponent) < 3 ? String(Number(number.toPrecision(3))) : `${mantissa}e${Number(exponent)}`;
  };

  const PREFIXES = { "-9": "n", "-6": "\u00b5", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };

  // In engineering notation: 27.8 MN/m, 41.2 µm; several numbers share the prefix of the greatest, except much smaller ones.
  function engineering(values, unit, digits = 3) {
    const all = [values].flat(), greatest = Math.max(...all.map(Math.abs));
    const parts = all.map((number) => {
      const value = Math.abs(number) < 1e-12 * greatest ? 0 : number; // treat rounding errors as zero
      const size = value !== 0 && Math.abs(value) < 1e-3 * greatest ? Math.abs(value) : greatest;
      const known = size > 0 && Number.isFinite(size) && unit !== "1";
      const power = known ? Math.min(9, Math.max(-9, 3 * Math.floor(Math.log10(size * 1.0005) / 3))) : 0;
      const text = Number.isFinite(value) ? Number((value / 10 ** power).toPrecision(digits)) : value;
      return [String(text).replace("-", "\u2212"), unit === "1" ? "" : `\u00a0${PREFIXES[power]}${untorn(unit)}`];
    });
    const shared = parts.every(([, written]) => written === parts[0][1]);
    return shared ? parts.map(([text]) => text).join(" \u00b7 ") + parts[0][1] : parts.map((part) => part.join("")).join(" \u00b7 ");
  }

  const untorn = (text) => text.replaceAll("N m", "N\u00a0m");

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
    if (data.roles && data.roles.length > 1) {
      const roles = element(legend, "div", "roles");
      data.roles.forEach(({ role, colour }) => {
        element(roles, "span", "swatch").style.background = colour;
        element(roles, "span", "", role);
      });
    }
    (data.lacks || []).forEach((line) => element(legend, "p", "lack", line));
    robot = data.machine && programs ? new Robot(data.machine, programs) : null;
    pose = robot ? robot.pose(data.q) : null;
    showSliders();
    data.legend.forEach(applyEntry);
    showNote(data.note || [], data.warnings || []);
    if (pose) showStopped();
    viewer.set_3d_pane_size();
    if (data.camera) frame(data.camera);
    if (!tidied) tidyControls();
    tidied = true;
    tell("panel");
  }

  // Show an entry, or hide it.
  function flip(key) {
    lineOf({ key }, "box").click();
  }

  function entryElement(entry) {
    const made = document.createElement("div");
    made.className = "entry";
    made.dataset.key = entry.key;
    const label = element(made, "label");
    const box = element(label, "input", "box");
    box.type = "checkbox";
    box.checked = isShown(entry);
    box.addEventListener("change", () => {
      shown.set(entry.key, box.checked);
      if (entry.live && pose) follow(entry);
      applyEntry(entry);
      viewer.set_dirty();
      tell("entries");
    });
    if (entry.colour) element(label, "span", "swatch").style.background = entry.colour;
    element(label, "span", "title", entry.title);
    element(made, "div", "values", untorn(entry.values || ""));
    entry.lines.forEach((line) => element(made, "div", "line", untorn(line)));
    if (entry.bar) {
      element(made, "div", "bar").style.background = `linear-gradient(to right, ${entry.bar.colours.join(", ")})`;
      const ends = element(made, "div", "ends");
      entry.bar.ends.forEach((end) => element(ends, "span", "", end));
    }
    return made;
  }

  // The line of an entry with a class: "values", or "line" for the first one below.
  function lineOf(entry, name) {
    return [...document.querySelectorAll(".entry")].find(({ dataset }) => dataset.key === entry.key).querySelector(`.${name}`);
  }

  function setValues(entry, text) {
    lineOf(entry, "values").textContent = untorn(text);
  }

  // Show, hide or paint the item of an entry of the legend.
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

  // Same as `reading` in pm3dof_pin/viewer/sliders.py.
  const written = ({ slider }, value) => fixed(value * slider.factor, slider.digits);
  const reading = (number, value) => `${number.label}\u00a0${written(number, value).replace("-", "\u2212")}${number.slider.unit}`;

  // A row for each number of the active set, and a tab for each set.
  function showSliders() {
    const form = document.getElementById("controls");
    form.hidden = !(robot && robot.data.sets.length);
    if (form.hidden) return;
    activeSet = Math.min(activeSet, robot.data.sets.length - 1);
    const wanted = JSON.stringify([activeSet, robot.data.sets]);
    if (wanted !== slidersShown) buildSliders();
    slidersShown = wanted;
    setSliders();
  }

  function buildSliders() {
    const sets = document.getElementById("sets"), sliders = document.getElementById("sliders");
    sets.textContent = sliders.textContent = "";
    robot.data.sets.forEach(({ title }, index) => {
      const button = element(sets, "button", index === activeSet ? "active" : "", title);
      button.type = "button";
      button.setAttribute("aria-pressed", index === activeSet);
      button.addEventListener("click", () => chooseSet(index));
    });
    const others = element(sets, "button", "others", "Modes");
    Object.assign(others, { type: "button", title: "assembly modes: other ways to assemble the machine at these numbers" });
    others.addEventListener("click", showAssemblies);
    others.hidden = !robot.data.has_closures;
    document.getElementById("assemblies").textContent = "";
    const back = element(sets, "button", "home", "Home");
    back.type = "button";
    back.addEventListener("click", home);
    robot.data.sets[activeSet].numbers.forEach((number, index) => {
      const { least, greatest, step, factor, unit } = number.slider;
      const row = element(sliders, "label");
      element(row, "span", "name", number.label).title = number.name;
      ["range", "number"].forEach((type) => {
        const input = element(row, "input");
        Object.assign(input, { type, min: least, max: greatest, step: type === "range" ? step : "any", name: number.name });
        input.addEventListener(type === "range" ? "input" : "change", () => {
          if (Number.isFinite(input.valueAsNumber)) slide(index, input.valueAsNumber / factor);
        });
        if (type !== "range") return;
        input.addEventListener("change", () => setSliders()); // the thumb goes where the machine is
        const place = (value) => `${(100 * (value * factor - least) / (greatest - least)).toFixed(2)}%`;
        const range = number.slider.range;
        if (range) input.style.cssText = `--from:${place(range[0])};--to:${place(range[1])}`;
      });
      element(row, "span", "unit", unit);
    });
  }

  function chooseSet(index) {
    if (!robot.data.sets[index]) return;
    activeSet = index;
    showSliders();
    tell("entries");
  }

  // Buttons for the other assembly modes at the same numbers of the active set.
  function showAssemblies() {
    const row = document.getElementById("assemblies"), set = robot.data.sets[activeSet];
    const found = robot.assemblies(set, pose.values(set));
    row.textContent = "";
    element(row, "span", "", found.length > 1 ? `${found.length} ways found:` : "no other way found");
    if (found.length > 1) {
      found.slice(0, 12).forEach((other, index) => {
        const broken = other.brokenLimits().length, button = element(row, "button", broken ? "outside" : "", String(index + 1));
        Object.assign(button, { type: "button", title: broken ? "outside the limits" : "within the limits" });
        button.addEventListener("click", () => show(other));
      });
    }
    return found.length;
  }

  // Move the sliders to the pose, except one that is being dragged.
  function setSliders(moving = null) {
    const set = robot.data.sets[activeSet], values = pose.values(set);
    document.querySelectorAll("#sliders label").forEach((row, index) => {
      const [range, number] = row.querySelectorAll("input");
      if (index !== moving) range.value = values[index] * set.numbers[index].slider.factor;
      number.value = written(set.numbers[index], values[index]);
    });
  }

  // Bring one number of a set, by default the active one, to a value [m, rad].
  function slide(index, value, set = robot.data.sets[activeSet]) {
    if (panel.immobile) {
      setSliders();
      return showNote(["The machine cannot leave this pose."], [panel.immobile]);
    }
    const start = pose.residual < 1e-6 ? pose : robot.home(); // not from open loops
    const wanted = start.values(set);
    wanted[index] = value;
    const found = robot.moved(start, set, wanted) || robot.moved(robot.home(), set, wanted);
    if (found) return show(found, index);
    const last = lastBefore(start, set, index, value);
    if (last) show(last, index);
    const others = robot.data.sets.filter((other) => other !== set).map(({ title }) => title.toLowerCase());
    const reason = robot.data.has_closures ? "Out of reach: the loops do not close there, or" : "Out of reach, or";
    const stuck = `Not even a small step is possible, as in a singular pose: move the ${others[0]} first.`;
    showNote(
      [set.numbers.map((number, k) => reading(number, wanted[k])).join(", "), "The picture shows the last pose found on the way."],
      [last || !others.length ? `${reason} a singular pose lies in between.` : stuck],
    );
  }

  // The last pose found on the way of one number to a value out of reach; null if there is none.
  function lastBefore(start, set, index, value) {
    let low = 0, high = 1, last = null;
    for (let halving = 0; halving < HALVINGS; halving++) {
      const values = start.values(set), part = (low + high) / 2;
      values[index] += part * (value - values[index]);
      const found = robot.moved(start, set, values);
      if (found) [last, low] = [found, part];
      else high = part;
    }
    return last;
  }

  // Let bodies at a limit glow red.
  function showStopped() {
    const stopped = pose.stoppedJoints();
    robot.data.bodies.forEach(({ path, joint }) => {
      const glow = joint && stopped.has(joint) ? STOPPED : 0;
      node(`${path}/visual`).object.traverse(({ material }) => material?.emissive?.setHex(glow));
    });
  }

  function home() {
    show(robot.home());
  }

  function show(found, moving = null) {
    if (viewer.animator.playing) viewer.animator.pause();
    pose = found;
    setSliders(moving);
    robot.data.bodies.forEach(({ path, joint, placement }) => {
      placeNode(path, Robot.product(pose.placement(joint), placement));
    });
    showStopped();
    followAll();
    const readings = robot.data.sets.map((set) => {
      const values = pose.values(set);
      return set.numbers.map((number, index) => reading(number, values[index]));
    });
    const lines = readings.filter((each) => each.join("").length <= robot.data.long_reading).map((each) => each.join(", "));
    if (robot.data.has_closures) lines.push(`loops closed to ${pose.residual ? pose.residual.toExponential(0) : 0} m, in this page`);
    showNote(lines, [...outsideLimits(pose.brokenLimits()), ...singular(pose)]);
    tell("pose");
  }

  // Update everything drawn for the pose; items that the page cannot compute are hidden.
  function followAll(others = leaveBehind) {
    const elastic = complianceOf(pose);
    panel.legend.forEach((entry) => (entry.live ? follow(entry, elastic) : others(entry)));
    viewer.set_dirty();
    tell("entries");
  }

  function complianceOf(found) {
    return panel.legend.some(({ live }) => live && live.kind !== "forces") ? robot.compliance(found) : null;
  }

  // Whether a pose is near one at which a motion becomes free with the drives at rest, or is lost however they move; and
  // how much more, or less, than at home the tool then moves for the same commands. Null elsewhere.
  function nearSingular(found) {
    const gains = robot.gains(found);
    if (!gains) return robot.programs.motion ? { kind: "free", ratio: Infinity } : null;
    robot.homeGains ??= robot.gains(robot.home());
    if (!robot.homeGains) return null;
    const [slow, fast] = gains.map((gain, k) => gain / robot.homeGains[k]);
    if (fast > NEAR_SINGULAR) return { kind: "free", ratio: fast };
    return slow < 1 / NEAR_SINGULAR ? { kind: "lost", ratio: 1 / slow } : null;
  }

  function singular(found) {
    const near = nearSingular(found);
    if (!near) return [];
    if (near.ratio === Infinity) return ["At or next to a singular pose; a ghost shows the motion."];
    const times = scientific(near.ratio);
    if (near.kind === "free") return [`Near a singular pose: the tool moves ${times} times as far as at home for the same commands; a ghost shows the motion.`];
    return [`Near a singular pose: in one direction commands move the tool ${times} times less than at home; a ghost shows how.`];
  }

  // Same as Viewer._note in pm3dof_pin/viewer/viewer.py.
  function outsideLimits(broken) {
    return broken.length ? ["Outside the joint limits:", ...broken] : [];
  }

  // Hide items computed elsewhere for another pose.
  function leaveBehind(entry) {
    if (!entry.of_pose) return;
    entry.stale = true;
    setValues(entry, "drawn for another pose: hidden");
    applyEntry(entry);
  }

  // By kind of the item; other parts of the page add theirs.
  const followers = { ellipsoid: followEllipsoid, forces: followForces, shares: followShares };

  // Update items computed for the previous pose, with C at the tool, or null if there is none.
  function follow(entry, compliance = complianceOf(pose)) {
    entry.stale = false;
    try {
      followers[entry.live.kind](entry, compliance);
    } catch (reason) {
      if (typeof reason !== "string") throw reason;
      entry.stale = true;
      setValues(entry, reason);
    }
    applyEntry(entry);
  }

  function followEllipsoid(entry, compliance) {
    const found = robot.ellipsoid(pose, entry.live, compliance);
    if (typeof found === "string") throw found;
    const { values, axes } = found;
    entry.principal = values;
    const greatest = Math.max(...values.map(Math.abs)), scale = fittingScale(entry, greatest, "semi-axis");
    const lengths = values.map((value) => scale * Math.max(Math.abs(value), 1e-6 * greatest));
    placeNode(entry.nodes[0], Robot.stretched(axes, lengths, pose.tool));
    setValues(entry, engineering(values.slice(-robot.count(entry.live.motion)), entry.live.unit));
  }

  // The scale of an entry, or a tenth or hundredth of it if the greatest value would be drawn far too long.
  function fittingScale(entry, greatest, what) {
    const { length, unit } = entry.live;
    let { scale } = entry.live;
    while (greatest * scale > 2 * length) scale /= 10;
    lineOf(entry, "line").textContent = `${what} of ${Number((1000 * length).toPrecision(6))} mm = ${engineering(length / scale, unit, 4)}`;
    return scale;
  }

  function followForces(entry) {
    const { width, unit } = entry.live;
    const forces = robot.holdingForces(pose);
    if (!forces) throw "no forces hold this singular pose";
    const scale = fittingScale(entry, Math.max(...forces.map(Math.abs)), "arrow");
    robot.actuatorAxes(pose).forEach(({ origin, direction }, index) => {
      const along = direction.map((part) => part * (forces[index] < 0 ? -1 : 1));
      const length = Math.max(Math.abs(forces[index]) * scale, 1e-6 * width), slim = Math.min(width, 0.5 * length);
      placeNode(entry.nodes[index], Robot.stretched(Robot.turnZTo(along), [slim, slim, length], origin));
    });
    setValues(entry, writtenForces(forces));
  }

  // Actuator forces with their units.
  function writtenForces(forces) {
    const units = robot.data.actuators.map(({ unit }) => unit);
    return new Set(units).size === 1 ? engineering(forces, units[0]) : forces.map((force, k) => engineering(force, units[k])).join(" \u00b7 ");
  }

  function followShares(entry, compliance) {
    if (!isShown(entry)) return setValues(entry, "");
    if (!compliance) throw "no stiffness in this pose";
    const { names, springs, stops, wrench } = entry.live;
    const shares = robot.shares(pose, springs, wrench);
    if (!shares.every(Number.isFinite)) throw "no spring deflects under this load";
    entry.paint.forEach((item) => { item.colour = blend(stops, shares[item.leg]); });
    const parts = shares.map((share, leg) => `${names[leg]}: ${fixed(100 * share, 1)} %`);
    const given = Robot.apply(compliance, wrench);
    const [shift, tilt] = [given.slice(0, 3), given.slice(3)].map((part) => Math.hypot(...part));
    setValues(entry, [...parts, `deflection ${engineering(shift, "m")}, ${engineering(tilt, "rad")}`].join("\n"));
  }

  // The colour at a place between 0 and 1 of a colour scale.
  function blend(stops, place) {
    const at = Math.min(1, Math.max(0, place)) * (stops.length - 1);
    const below = Math.min(Math.floor(at), stops.length - 2);
    return stops[below].map((part, index) => part + (at - below) * (stops[below + 1][index] - part));
  }

  // ---------------------------------------------------------------------------------------------- start

  const openSocket = () => new WebSocket(`${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}/socket`);

  function connect() {
    const socket = openSocket();
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onclose = () => {
      showNote(["The program that served this page has ended.", "The page remains usable, and returns to the program when it runs again."]);
      comeBack();
    };
  }

  // Load the page anew, perhaps of another robot, once a program serves it again. Not at once: one that is ending may
  // still accept a connection, but no longer serve the page.
  function comeBack() {
    setTimeout(() => {
      const socket = openSocket();
      socket.onopen = () => location.reload();
      socket.onerror = comeBack;
    }, AGAIN);
  }

  const start = () => {
    viewer.set_3d_pane_size();
    receive(JSON.parse(document.getElementById("scene").textContent));
    if (document.body.dataset.socket === "yes") connect();
  };

  // A pose not set by sliders: of a playing path, which provides what the page cannot compute.
  function setPose(found) {
    pose = found;
    setSliders();
    followAll(() => {});
  }

  const state = { pose: () => pose, robot: () => robot, panel: () => panel, set: () => robot.data.sets[activeSet] };
  // The whole machine from the first direction, at home.
  function reset() {
    if (robot) home();
    reframe();
  }

  const drawing = { viewer, reset, blend, node, placeNode, pane, turn, bare, element, engineering, scientific, fixed, isShown, setValues, showNote };
  return { ...drawing, ...state, on, tell, flip, update: follow, followers, fittingScale, nearSingular, slide, chooseSet, home, showAssemblies, show, setPose, followAll, lineOf, receive, start };
})();
