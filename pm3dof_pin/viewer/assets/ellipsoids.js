// Options of the ellipsoids: quantity, free or held other motions, and load; and numbers at their axes.
"use strict";

hasWebGL && (() => {
  const { viewer, node, element, engineering, isShown, on, tell, followAll, lineOf } = pm3dof;
  const form = document.getElementById("choices");
  const selects = { of: form.querySelector("[name=of]"), others: form.querySelector("[name=others]") };
  const labels = document.getElementById("labels");
  const EDGE = 6; // between a number and the edge of the picture [pixels]
  const CLOSE = 17, LETTER = 7; // pixels: least distance between labels; width of a letter
  const scales = new Map(); // of ellipsoids selected here, kept so that they can be compared
  let chosen = null; // by the user: of and others
  let wrench = null;

  const live = (kind) => pm3dof.panel().legend.filter((entry) => entry.live && entry.live.kind === kind);
  const usual = (of) => (of === "stiffness" ? "held" : "free");
  const isElastic = (of) => of === "stiffness" || of === "compliance";

  // Quantities that have an ellipsoid at home or at the displayed pose.
  function quantities() {
    const robot = pm3dof.robot(), known = new Set();
    [robot.home(), pm3dof.pose()].forEach((pose) => {
      const compliance = robot.compliance(pose);
      robot.data.ellipsoids.forEach(({ of, motion }) => ["held", "free"].forEach((others) => {
        if (typeof robot.ellipsoid(pose, { of, motion, others }, compliance) !== "string") known.add(of);
      }));
    });
    return [...new Set(robot.data.ellipsoids.map(({ of }) => of))].filter((of) => known.has(of));
  }

  // The greatest length, 1, 2 or 5 times a power of ten, for a value, within what suits the robot.
  function roundScale(greatest, length) {
    if (!(greatest > 0)) return length;
    const power = 10 ** Math.floor(Math.log10(greatest));
    return length / [1, 2, 5, 10].map((factor) => factor * power).find((step) => greatest <= step * (1 + 1e-9));
  }

  function show(entry, of, others) {
    const robot = pm3dof.robot(), { motion, length } = entry.live;
    const { unit } = robot.data.ellipsoids.find((each) => each.of === of && each.motion === motion);
    const shown = { ...entry.live, of, others, unit };
    const key = [motion, of, others].join();
    if (!scales.has(key)) {
      const found = robot.ellipsoid(pm3dof.pose(), shown, robot.compliance(pm3dof.pose()));
      if (typeof found === "string") {
        entry.live = { ...shown, scale: length };
        return retitle(entry);
      }
      const sizes = found.values.map(Math.abs);
      scales.set(key, roundScale(Math.max(...sizes, 3 * Math.min(...sizes)), length));
    }
    entry.live = { ...shown, scale: scales.get(key) };
    retitle(entry);
  }

  function retitle(entry) {
    const { of, others, motion } = entry.live, { explanations } = pm3dof.robot().data;
    entry.title = `${motion[0].toUpperCase()}${motion.slice(1)} ${of}`;
    const said = isElastic(of) ? `${motion === "translation" ? "rotations" : "translations"} ${others}` : explanations[of];
    const made = lineOf(entry, "values").parentElement;
    made.querySelector(".title").textContent = entry.title;
    made.querySelectorAll(".line")[1].textContent = said;
  }

  // Show a quantity; the other motions are as usual unless given.
  function choose(of, others = usual(of)) {
    chosen = { of, others };
    live("ellipsoid").forEach((entry) => show(entry, of, others));
    fill();
    followAll();
    tell("choice");
  }

  // The load of the shares and of the deflection [N, N m].
  function load(values) {
    wrench = values;
    loaded().forEach((entry) => { entry.live.wrench = values; });
    live("shares").forEach((entry) => { lineOf(entry, "line").textContent = "under the load"; });
    document.querySelectorAll(".load input").forEach((input, index) => { input.value = values[index]; });
    followAll();
    tell("choice");
  }

  function fill() {
    const [entry] = live("ellipsoid");
    form.hidden = !entry || !pm3dof.robot();
    if (form.hidden) return;
    const { of, others } = entry.live;
    selects.of.textContent = "";
    quantities().forEach((name) => {
      const option = element(selects.of, "option", "", name);
      option.value = name;
      option.selected = name === of;
    });
    selects.others.value = others;
    selects.others.disabled = !isElastic(of);
  }

  const loaded = () => [...live("load"), ...live("shares")];

  // Six fields for the load, in an entry.
  function fields(entry) {
    const row = document.createElement("div");
    row.className = "load";
    ["Fx", "Fy", "Fz", "Mx", "My", "Mz"].forEach((name, index) => {
      const label = element(row, "label", "", name), input = element(label, "input");
      Object.assign(input, { type: "number", step: "any", value: entry.live.wrench[index], title: index < 3 ? "N" : "N m" });
      input.addEventListener("change", () => {
        const values = [...row.querySelectorAll("input")].map((each) => each.valueAsNumber);
        if (values.every(Number.isFinite) && values.some((value) => value !== 0)) load(values);
      });
    });
    lineOf(entry, "line").after(row);
  }

  function panelChanged() {
    if (pm3dof.robot()) {
      if (wrench) loaded().forEach((entry) => { entry.live.wrench = wrench; });
      loaded().slice(0, 1).forEach(fields);
      const offered = chosen && live("ellipsoid").length && quantities().includes(chosen.of);
      if (offered) choose(chosen.of, chosen.others);
    }
    fill();
    write();
  }

  // ------------------------------------------------------------------------------- numbers in the picture

  // Position of a point of the machine in the picture [pixels]; null behind the camera.
  function project(point) {
    const at = viewer.scene.localToWorld(new MeshCat.THREE.Vector3(...point)).project(viewer.camera);
    const { clientWidth, clientHeight } = viewer.renderer.domElement;
    return Math.abs(at.z) < 1 ? [(at.x + 1) / 2 * clientWidth, (1 - at.y) / 2 * clientHeight] : null;
  }

  // A number at the end of every semi-axis, except where it would overlap another.
  function write() {
    const taken = [], tools = document.getElementById("tools").getBoundingClientRect(), pane = pm3dof.pane();
    labels.textContent = "";
    pm3dof.panel().legend.filter((entry) => entry.principal && isShown(entry) && !entry.stale).forEach((entry) => {
      const { elements: m } = node(entry.nodes[0]).object.matrix;
      [2, 1, 0].forEach((axis) => {
        const tips = [1, -1].map((sign) => project([0, 1, 2].map((row) => m[12 + row] + sign * m[4 * axis + row])));
        if (tips.some((tip) => !tip)) return;
        const [tip, y] = tips[0][1] < tips[1][1] ? tips[0] : tips[1];
        const middle = project([m[12], m[13], m[14]]);
        if (Math.hypot(tip - middle[0], y - middle[1]) < CLOSE / 2) return;
        const text = engineering(entry.principal[axis], entry.live ? entry.live.unit : entry.unit), width = LETTER * text.length;
        const x = Math.min(tip, pane.width - width / 2 - EDGE); // whole, beside the edge
        if (tip - x > width || y > pane.height) return;
        if (x + width / 2 > tools.left && x - width / 2 < tools.right && y - 2 * CLOSE < tools.bottom) return;
        if (taken.some(([a, b, other]) => Math.abs(y - b) < CLOSE && Math.abs(x - a) < (width + other) / 2 + 8)) return;
        taken.push([x, y, width]);
        const label = element(labels, "span", "", text);
        label.style.cssText = `left:${x.toFixed(1)}px;top:${y.toFixed(1)}px;--own:${entry.colour}`;
      });
    });
  }

  selects.of.addEventListener("change", () => choose(selects.of.value));
  selects.others.addEventListener("change", () => choose(selects.of.value, selects.others.value));
  form.addEventListener("submit", (event) => event.preventDefault());
  on("panel", panelChanged);
  on("picture", write);
  Object.assign(pm3dof, { choose, load, project, roundScale, quantities, choice: () => chosen, wrench: () => wrench });
})();
