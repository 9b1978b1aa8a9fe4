// A path: its scrubber, and a plot of a quantity along it; a click goes there.
"use strict";

hasWebGL && (() => {
  const { viewer, element, engineering, on } = pm3dof;
  const bar = document.getElementById("path");
  const scrubber = bar.querySelector("input"), button = bar.querySelector("button"), select = bar.querySelector("select");
  const graph = bar.querySelector("svg");
  const HEIGHT = 140, LEFT = 48, RIGHT = 12, HEAD = 20, FOOT = 18; // of the plot and its margins [pixels]
  const PLAIN = ["", "\u00b0"]; // units without prefixes
  let width = 600;
  const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00"];
  let path = null, poses = [], time = null, series = null;

  const svg = (parent, tag, attributes) => {
    const made = parent.appendChild(document.createElementNS("http://www.w3.org/2000/svg", tag));
    Object.entries(attributes).forEach(([name, value]) => made.setAttribute(name, value));
    return made;
  };

  const across = (part) => LEFT + (width - LEFT - RIGHT) * part;
  const tickText = (value) => String(Number(value.toPrecision(6))).replace("-", "\u2212");

  // Round numbers between two, at most so many and one.
  function ticks(low, high, count) {
    const power = 10 ** Math.floor(Math.log10((high - low) / count));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((each) => (high - low) / each <= count);
    const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
    return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step);
  }

  // Powers of ten between two numbers, or 1, 2 and 5 times these if they are few.
  function logarithmicTicks(low, high) {
    const powers = Array.from({ length: 40 }, (_, k) => 10 ** (k - 20)).filter((each) => each > low / 10 && each < high * 1.001);
    const inside = powers.filter((each) => each >= low * 0.999);
    return inside.length > 2 ? inside : powers.flatMap((each) => [each, 2 * each, 5 * each]).filter((each) => each >= low * 0.999 && each <= high * 1.001);
  }

  // Quantities that can be plotted: title, names of the lines, unit, and the numbers of a pose.
  function choices() {
    const robot = pm3dof.robot(), made = [];
    robot.data.sets.forEach((set) => {
      [["m", "lengths", 1], ["rad", "angles", 180 / Math.PI]].forEach(([unit, what, factor]) => {
        const kept = set.numbers.map((number, k) => [number, k]).filter(([number]) => number.unit === unit);
        if (!kept.length) return;
        const values = (pose) => { const all = pose.values(set); return kept.map(([, k]) => all[k] * factor); };
        made.push({ title: `${set.title.toLowerCase()}: ${what}`, names: kept.map(([{ name }]) => name), unit: unit === "m" ? "m" : "\u00b0", values });
      });
    });
    pm3dof.panel().legend.filter(({ live }) => live && live.kind === "ellipsoid").forEach((entry) => {
      const values = (pose) => {
        const found = robot.ellipsoid(pose, entry.live, robot.compliance(pose));
        return typeof found === "string" ? [NaN, NaN] : [found.values[0], found.values[2]];
      };
      made.push({ title: entry.title.toLowerCase(), names: ["least", "greatest"], unit: entry.live.unit, values });
    });
    const shares = pm3dof.panel().legend.find(({ live }) => live && live.kind === "shares");
    if (shares) {
      const values = (pose) => {
        const C = robot.compliance(pose);
        return [C ? Math.hypot(...Robot.apply(C, shares.live.wrench).slice(0, 3)) : NaN];
      };
      made.push({ title: "deflection under the load", names: ["tool"], unit: "m", values });
    }
    if (robot.programs.holding) {
      const names = robot.data.commands.map(({ name }) => name), none = names.map(() => NaN);
      const units = new Set(robot.data.actuators.map(({ unit }) => unit));
      made.push({ title: "holding forces", names, unit: [...units].join(", "), values: (pose) => robot.holdingForces(pose) || none });
    }
    if (robot.programs.motion) {
      made.push({ title: "motion per command, scaled", names: ["slowest", "fastest"], unit: "", values: (pose) => robot.gains(pose) || [NaN, NaN] });
    }
    const singularity = Object.entries(path.singularity);
    if (singularity.length) {
      const values = (pose, index) => singularity.map(([, distances]) => distances[index]);
      made.push({ title: "distance to singularities", names: singularity.map(([name]) => name), unit: "", values });
    }
    return made;
  }

  function panelChanged() {
    path = pm3dof.panel().path || null;
    bar.hidden = !path;
    document.body.classList.toggle("has-path", Boolean(path));
    if (!path) return;
    time = viewer.animator.time;
    Object.assign(scrubber, { min: 0, max: path.frames.length - 1, step: 1 });
    const robot = pm3dof.robot();
    select.hidden = graph.toggleAttribute("hidden", !robot);
    if (!robot) return;
    poses = path.frames.map(({ q }) => robot.pose(q));
    takeOver();
    fill();
  }

  // Items that the page computes for the user's options are not animated as well.
  function takeOver() {
    const { animator } = viewer, live = pm3dof.panel().legend.filter((entry) => entry.live);
    const own = new Set(live.flatMap(({ nodes }) => nodes.map((name) => pm3dof.node(name).object)));
    animator.actions.filter((action) => own.has(action.getRoot())).forEach((action) => action.stop());
    animator.actions = animator.actions.filter((action) => !own.has(action.getRoot()));
    pm3dof.setPose(poses[frame()]);
  }

  function fill() {
    const before = select.value;
    select.textContent = "";
    series = choices();
    series.forEach(({ title }) => { element(select, "option", "", title).value = title; });
    if (series.some(({ title }) => title === before)) select.value = before;
    draw();
  }

  function draw() {
    const chosen = series.find(({ title }) => title === select.value) || series[0];
    graph.textContent = "";
    if (!chosen) return;
    width = graph.clientWidth || width;
    graph.setAttribute("viewBox", `0 0 ${width} ${HEIGHT}`);
    const rows = poses.map(chosen.values), finite = rows.flat().filter(Number.isFinite);
    if (!finite.length) return;
    let low = Math.min(...finite), high = Math.max(...finite);
    const positive = low > 0 && high > 20 * low, place = positive ? Math.log : (value) => value;
    if (high - low <= 1e-9 * Math.max(Math.abs(high), Math.abs(low))) [low, high] = [low - Math.abs(low || 1) * 0.5, high + Math.abs(high || 1) * 0.5];
    const x = (k) => across(k / Math.max(1, rows.length - 1));
    const y = (value) => HEIGHT - FOOT - (HEIGHT - FOOT - HEAD) * (place(value) - place(low)) / (place(high) - place(low));
    const power = PLAIN.includes(chosen.unit) ? 0 : Math.min(9, Math.max(-9, 3 * Math.floor(Math.log10(Math.max(...finite.map(Math.abs)) || 1) / 3)));
    const unit = PLAIN.includes(chosen.unit) ? chosen.unit : engineering(10 ** power, chosen.unit, 1).replace(/^1\u00a0?/, "");
    (positive ? logarithmicTicks : ticks)(low, high, 4).forEach((value) => {
      svg(graph, "line", { x1: LEFT, x2: width - RIGHT, y1: y(value), y2: y(value), class: "grid" });
      svg(graph, "text", { x: LEFT - 5, y: y(value) + 4, "text-anchor": "end" }).textContent = tickText(value / 10 ** power);
    });
    ticks(0, path.duration, 6).forEach((value) => {
      const at = across(value / path.duration);
      svg(graph, "line", { x1: at, x2: at, y1: HEIGHT - FOOT, y2: HEIGHT - FOOT + 4, class: "axis" });
      svg(graph, "text", { x: at, y: HEIGHT - 4, "text-anchor": "middle" }).textContent = `${tickText(value)}${value ? "" : "\u00a0s"}`;
    });
    svg(graph, "path", { d: `M${LEFT} ${HEAD}V${HEIGHT - FOOT}H${width - RIGHT}`, class: "axis" });
    svg(graph, "text", { x: 4, y: 12 }).textContent = unit || "1";
    chosen.names.forEach((name, line) => {
      let d = "", drawn = false;
      rows.forEach((row, k) => {
        if (Number.isFinite(row[line])) d += `${drawn ? "L" : "M"}${x(k).toFixed(1)} ${y(row[line]).toFixed(1)}`;
        drawn = Number.isFinite(row[line]);
      });
      svg(graph, "path", { d, stroke: COLOURS[line % COLOURS.length], class: "line" });
      svg(graph, "text", { x: width - 6 - 62 * (chosen.names.length - 1 - line), y: 12, fill: COLOURS[line % COLOURS.length], "text-anchor": "end" }).textContent = name;
    });
    svg(graph, "line", { y1: HEAD, y2: HEIGHT - FOOT, class: "cursor" });
    point(frame());
  }

  const frame = () => Math.min(path.frames.length - 1, Math.max(0, Math.round(viewer.animator.time / path.duration * (path.frames.length - 1))));

  function point(index) {
    scrubber.value = index;
    const cursor = graph.querySelector(".cursor"), place = across(index / Math.max(1, path.frames.length - 1));
    if (cursor) ["x1", "x2"].forEach((name) => cursor.setAttribute(name, place));
  }

  // Stop at a frame of the path.
  function go(index) {
    const { animator } = viewer, seconds = index / (path.frames.length - 1) * path.duration;
    animator.pause();
    animator.seek(seconds);
    animator.display_progress(seconds);
    time = seconds;
    point(index);
    if (pm3dof.robot()) pm3dof.show(poses[index]);
    else tellOf(index);
    label();
  }

  function tellOf(index) {
    const at = path.frames[index];
    pm3dof.showNote(at.note, at.warnings);
    pm3dof.panel().legend.forEach((entry) => { if (entry.key in at.values) pm3dof.setValues(entry, at.values[entry.key]); });
  }

  // Plot a quantity, by its title.
  function plot(title) {
    if (!path || !series || !series.some((each) => each.title === title)) return;
    select.value = title;
    draw();
  }

  const label = () => { button.textContent = viewer.animator.playing ? "\u2016" : "\u25b6"; };

  function toggle() {
    if (!path) return;
    if (viewer.animator.playing) go(frame());
    else viewer.animator.play();
    label();
  }

  // Numbers, sliders and the cursor follow the playing path.
  function watch() {
    requestAnimationFrame(watch);
    if (!path || viewer.animator.time === time) return;
    time = viewer.animator.time;
    const index = frame();
    point(index);
    tellOf(index);
    if (pm3dof.robot()) pm3dof.setPose(poses[index]);
    label();
  }

  button.addEventListener("click", toggle);
  scrubber.addEventListener("input", () => go(scrubber.valueAsNumber));
  select.addEventListener("change", () => { draw(); pm3dof.tell("entries"); });
  graph.addEventListener("click", (event) => {
    const box = graph.getBoundingClientRect(), part = ((event.clientX - box.left) / box.width * width - LEFT) / (width - LEFT - RIGHT);
    go(Math.round(Math.min(1, Math.max(0, part)) * (path.frames.length - 1)));
  });
  on("panel", panelChanged);
  on("choice", () => { if (path && pm3dof.robot()) fill(); });
  window.addEventListener("resize", () => { if (path && pm3dof.robot()) draw(); });
  requestAnimationFrame(watch);
  Object.assign(pm3dof, { go, toggle, frame, plot, plotted: () => path && select.value });
})();
