// Light and dark theme, keys, and a link to the displayed state.
"use strict";

hasWebGL && (() => {
  const { viewer, on, home } = pm3dof;
  const DARK = { top_color: [0.13, 0.15, 0.18], bottom_color: [0.055, 0.065, 0.08] };
  const FLOOR = [0.22, 0.245, 0.28, 1];
  const light = {};
  let theme = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  let waiting = null;

  // ---------------------------------------------------------------------------------------------- theme

  function setTheme(name) {
    theme = name;
    document.documentElement.dataset.theme = name;
    const background = pm3dof.node("/Background").object;
    if (!light.top_color) Object.keys(DARK).forEach((key) => { light[key] = background[key].map((part) => part / 255); }); // meshcat stores bytes
    const colours = name === "dark" ? DARK : light;
    Object.entries(colours).forEach(([key, colour]) => viewer.set_property(["Background"], key, colour));
    const { material } = pm3dof.node("/floor/plate/<object>").object;
    if (material) {
      light.floor ??= [...material.color.toArray(), 1];
      material.color.fromArray(name === "dark" ? FLOOR : light.floor);
    }
    viewer.set_dirty();
  }

  // The user's choice, which is included in the link.
  function chooseTheme(name) {
    document.documentElement.dataset.chosen = "yes";
    setTheme(name);
    keep();
  }

  const other = () => chooseTheme(theme === "dark" ? "light" : "dark");

  // ----------------------------------------------------------------------------------------------- keys

  const help = document.getElementById("help");
  const keys = {
    h: home,
    r: pm3dof.reset,
    p: () => pm3dof.takePicture(),
    t: other,
    e: () => next("of"),
    o: () => next("others"),
    " ": () => pm3dof.toggle(),
    c: () => { if (document.body.classList.toggle("controls")) viewer.gui.open(); },
    "?": () => { help.hidden = !help.hidden; },
    Escape: () => { help.hidden = true; },
  };

  function next(name) {
    const select = document.querySelector(`#choices [name=${name}]`);
    if (document.getElementById("choices").hidden || select.disabled) return;
    select.selectedIndex = (select.selectedIndex + 1) % select.options.length;
    select.dispatchEvent(new Event("change"));
  }

  // Digits select a slider, which arrow keys then move.
  function pressed(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=number], select, textarea")) return;
    const sliders = document.querySelectorAll("#sliders input[type=range]");
    if (/^[1-9]$/.test(event.key) && sliders[event.key - 1]) sliders[event.key - 1].focus();
    else if (keys[event.key] && (pm3dof.robot() || !"heo".includes(event.key))) keys[event.key]();
    else return;
    event.preventDefault();
  }

  // ----------------------------------------------------------------------------------------------- link

  // The displayed state, for the fragment of the URL.
  function written() {
    const robot = pm3dof.robot(), parts = new URLSearchParams(), choice = pm3dof.choice(), wrench = pm3dof.wrench();
    parts.set("robot", pm3dof.panel().robot);
    if (robot) {
      const pose = pm3dof.pose(), [set] = robot.data.sets, short = (values) => [...values].map((value) => Number(value.toPrecision(9))).join(",");
      const values = set ? pose.values(set) : [], usual = set && robot.moved(robot.home(), set, values);
      parts.set("pose", short(values));
      // for assembly modes other than that of home, the link contains all joints
      if (!usual || usual.q.some((entry, k) => Math.abs(entry - pose.q[k]) > 1e-6)) parts.set("q", short(pose.q));
      if (robot.data.sets.indexOf(pm3dof.set()) > 0) parts.set("sliders", robot.data.sets.indexOf(pm3dof.set()));
    }
    if (choice) parts.set("ellipsoids", `${choice.of},${choice.others}`);
    if (wrench) parts.set("load", wrench.join(","));
    if (pm3dof.panel().legend.some(({ cut }) => cut)) parts.set("cut", Object.values(pm3dof.cut()).join(","));
    if (pm3dof.plotted()) parts.set("plot", pm3dof.plotted());
    if (pm3dof.panel().path && !viewer.animator.playing) parts.set("frame", pm3dof.frame());
    const hidden = pm3dof.panel().legend.filter((entry) => !pm3dof.isShown(entry)).map(({ key }) => key);
    if (hidden.length) parts.set("hidden", hidden.join(","));
    const camera = [...viewer.camera.position.toArray(), ...viewer.controls.target.toArray()];
    parts.set("camera", camera.map((value) => Number(value.toPrecision(5))).join(","));
    if (document.documentElement.dataset.chosen) parts.set("theme", theme);
    return parts.toString().replaceAll("%2C", ",");
  }

  function keep() {
    clearTimeout(waiting);
    waiting = setTimeout(() => history.replaceState(null, "", `#${written()}`), 400);
  }

  const listed = (text) => (text || "").split(",").map(Number);

  // Restore the state of a URL; what it lacks, or says of another robot, is unchanged.
  function follow(text) {
    const parts = new URLSearchParams(text), robot = pm3dof.robot();
    if (parts.has("robot") && parts.get("robot") !== pm3dof.panel().robot) return; // another robot on the same address
    if (["light", "dark"].includes(parts.get("theme"))) chooseTheme(parts.get("theme"));
    const hidden = parts.has("hidden") ? parts.get("hidden").split(",") : [];
    if (parts.has("camera")) {
      pm3dof.panel().legend.forEach((entry) => { if (pm3dof.isShown(entry) === hidden.includes(entry.key)) pm3dof.flip(entry.key); });
    }
    if (robot) {
      const [set] = robot.data.sets, values = listed(parts.get("pose"));
      if (parts.has("sliders")) pm3dof.chooseSet(Number(parts.get("sliders")));
      if (pm3dof.panel().path?.frames[parts.get("frame")]) pm3dof.go(Number(parts.get("frame")));
      if (set && values.length === set.numbers.length && values.every(Number.isFinite)) {
        const q = listed(parts.get("q")), near = q.length === robot.data.home.length && q.every(Number.isFinite);
        const found = robot.moved(near ? robot.pose(q) : robot.home(), set, values);
        if (found) pm3dof.show(found);
      }
      const [of, others] = (parts.get("ellipsoids") || "").split(",");
      if (!document.getElementById("choices").hidden && pm3dof.quantities().includes(of) && ["free", "held"].includes(others)) pm3dof.choose(of, others);
      const load = listed(parts.get("load"));
      if (load.length === 6 && load.every(Number.isFinite) && load.some((value) => value !== 0)) pm3dof.load(load);
    }
    if (parts.has("cut")) pm3dof.cutTo(...listed(parts.get("cut")));
    if (parts.has("plot")) pm3dof.plot(parts.get("plot"));
    const camera = listed(parts.get("camera"));
    if (camera.length === 6 && camera.every(Number.isFinite)) {
      viewer.camera.position.fromArray(camera);
      viewer.controls.target.fromArray(camera.slice(3));
      viewer.controls.update();
    }
    viewer.set_dirty();
  }

  document.getElementById("theme").addEventListener("click", other);
  document.getElementById("help-button").addEventListener("click", keys["?"]);
  window.addEventListener("keydown", pressed);
  ["pose", "entries", "choice"].forEach((event) => on(event, keep));
  viewer.controls.addEventListener("end", keep);
  let started = false;
  on("panel", () => {
    setTheme(theme);
    if (!started && location.hash.length > 1) follow(location.hash.slice(1));
    started = true;
  });
  Object.assign(pm3dof, { setTheme: chooseTheme, follow, written });
})();
