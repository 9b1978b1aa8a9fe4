// Swinging ghosts of the machine: near a singular pose the motion that becomes free, or is lost; and natural modes.
"use strict";

hasWebGL && (() => {
  const { viewer, Ghost, on, isShown } = pm3dof;
  const { THREE } = MeshCat;
  const PATH = "/free_motion", COLOUR = 0x2a52ff, OPACITY = 0.3;
  const SAME = 1e-9; // pose, in joint positions
  const STEP = 1e-4; // of a number, for derivatives [rad, characteristic lengths]
  const SWING = 0.2; // greatest change of a joint [rad, characteristic lengths]
  const FRAMES = 6; // on either side of the pose
  const PERIOD = 2400; // [ms]
  const PAUSE = 150; // after the last move [ms]
  const NEGLIGIBLE = 1e-14; // of the greatest squared motion
  const modes = new Map(); // ghosts, by entry
  const calm = matchMedia("(prefers-reduced-motion: reduce)");
  let ghost = null, frames = [], waiting = null, poseOf = null, running = false;

  const transposed = (rows) => rows[0].map((_, k) => rows.map((row) => row[k]));
  const gram = (columns) => columns.map((a) => columns.map((b) => a.reduce((sum, entry, i) => sum + entry * b[i], 0)));
  const times = (a, b) => a.map((row) => transposed(b).map((column) => row.reduce((sum, entry, i) => sum + entry * column[i], 0)));

  // Changes of the joints and of what should move, or not, with them, by each number of a set.
  function changes(robot, pose, set, seen) {
    const { length, joints } = robot.data, scales = new Float64Array(pose.q.length).fill(1);
    joints.filter(({ slides }) => slides).forEach(({ index }) => { scales[index] = 1 / length; });
    const values = pose.values(set), columns = [];
    for (let k = 0; k < values.length; k++) {
      const step = STEP * Math.abs(set.numbers[k].scale) * (set.numbers[k].unit === "m" ? length : 1);
      const [low, high] = [-1, 1].map((sign) => {
        const beside = values.slice();
        beside[k] += sign * step;
        return robot.moved(pose, set, beside);
      });
      if (!low && !high) return null;
      const [a, b] = [low || pose, high || pose], part = STEP * (low && high ? 2 : 1), [before, after] = [a, b].map(seen);
      columns.push({
        step: step / STEP,
        joints: [...b.q].map((entry, i) => (entry - a.q[i]) * scales[i] / part),
        seen: after.map((entry, i) => (entry - before[i]) / part),
      });
    }
    return columns;
  }

  // The changes of a set's numbers for which least is seen to move, relative to the joints; with that ratio, squared.
  function leastSeen(columns) {
    const { values, axes } = Robot.eigen(gram(columns.map(({ joints }) => joints))), greatest = Math.max(...values);
    const kept = values.map((value, k) => [value, k]).filter(([value]) => value > NEGLIGIBLE * greatest);
    const white = axes.map((row) => kept.map(([value, k]) => row[k] / Math.sqrt(value)));
    const found = Robot.eigen(times(times(transposed(white), gram(columns.map(({ seen }) => seen))), white));
    const least = found.values.indexOf(Math.min(...found.values));
    const weights = white.map((row) => row.reduce((sum, entry, k) => sum + entry * found.axes[k][least], 0));
    return { ratio: found.values[least], weights };
  }

  // Poses of the motion with drives at rest ("free"), or with the tool at rest ("lost"); none if there is no way to any.
  function swing(kind) {
    const robot = pm3dof.robot(), pose = pm3dof.pose(), { length, commands } = robot.data;
    const units = commands.map(({ unit, scale }) => (unit === "m" ? length : 1) * Math.abs(scale));
    const ofDrives = (at) => at.values({ numbers: commands }).map((value, k) => value / units[k]);
    const ofTool = (at) => at.toolComponents.map((value, k) => (k < 3 ? value / length : value));
    const found = robot.data.sets.map((set) => {
      const columns = changes(robot, pose, set, kind === "free" ? ofDrives : ofTool);
      return columns && { set, columns, ...leastSeen(columns) };
    }).filter(Boolean).sort((a, b) => a.ratio - b.ratio)[0];
    if (!found || !found.weights.every(Number.isFinite)) return [];
    const { set, columns, weights } = found, values = pose.values(set);
    const moves = pose.q.length && [...pose.q].map((_, i) => columns.reduce((sum, { joints }, k) => sum + weights[k] * joints[i], 0));
    const size = SWING / Math.max(...moves.map(Math.abs));
    const steps = Array.from({ length: 2 * FRAMES + 1 }, (_, k) => size * (k - FRAMES) / FRAMES);
    const reached = steps.map((part) => robot.moved(pose, set, values.map((value, k) => value + part * weights[k] * columns[k].step)));
    const [low, high] = [-1, 1].map((sign) => { // as far as it goes on each side
      let k = FRAMES;
      while (reached[k + sign]) k += sign;
      return k;
    });
    return reached.slice(Math.min(low, FRAMES), high + 1).map((each, k) => (k + low === FRAMES ? pose : each));
  }

  function look() {
    const robot = pm3dof.robot(), pose = robot && pm3dof.pose(), near = pose && pm3dof.nearSingular(pose);
    stop();
    if (!near || !robot.data.commands.length || robot.data.tool === null) return;
    frames = swing(near.kind);
    if (frames.length < 2) return;
    poseOf = pose;
    ghost = new Ghost(PATH, robot.data.bodies.filter(({ joint }) => joint), COLOUR, OPACITY);
    ghost.visible = true;
    animate(0);
  }

  function stop() {
    if (ghost) ghost.visible = false;
    ghost = poseOf = null;
    frames = [];
    viewer.set_dirty();
  }

  // ------------------------------------------------------------------------------------- natural modes

  const swingingModes = () => [...modes].filter(([entry]) => !entry.stale && isShown(entry));

  // Bodies a part of the way along their twists [v; w] at their joints, world axes; linear, as modes are.
  function displaced(pose, twists, part) {
    return {
      placement(joint) {
        const own = new THREE.Matrix4().fromArray(pose.placement(joint)), at = new THREE.Vector3().setFromMatrixPosition(own);
        const [shift, turn] = [0, 3].map((k) => new THREE.Vector3(...twists[joint].slice(k, k + 3)).multiplyScalar(part));
        const angle = turn.length(), moved = new THREE.Matrix4();
        if (angle) moved.makeRotationAxis(turn.divideScalar(angle), angle);
        return own.setPosition(0, 0, 0).premultiply(moved).setPosition(at.add(shift)).toArray();
      },
    };
  }

  function followMode(entry) {
    const { q, values } = entry.live, pose = pm3dof.pose();
    if (q.some((number, k) => Math.abs(number - pose.q[k]) > SAME)) throw "of another pose: hidden";
    pm3dof.setValues(entry, values);
    if (modes.has(entry)) modes.get(entry).place(displaced(pose, entry.live.twists, 1));
    animate(0);
  }

  function buildModes() {
    const robot = pm3dof.robot();
    modes.clear();
    if (!robot) return;
    pm3dof.panel().legend.filter(({ live }) => live && live.kind === "mode").forEach((entry) => {
      modes.set(entry, new Ghost(entry.nodes[0], robot.data.bodies.filter(({ joint }) => joint), COLOUR, OPACITY));
      pm3dof.update(entry);
    });
  }

  // -------------------------------------------------------------------------------------

  function animate(now) {
    if (running && !now) return; // asked for while it runs
    const free = ghost && pm3dof.pose() === poseOf, shown = swingingModes();
    running = Boolean(free || shown.length) && !calm.matches;
    const phase = running ? 2 * Math.PI * now / PERIOD : Math.PI / 2;
    if (free) ghost.place(frames[Math.round((calm.matches ? 1 : 0.5 - 0.5 * Math.cos(phase)) * (frames.length - 1))]);
    shown.forEach(([entry, swinging]) => swinging.place(displaced(pm3dof.pose(), entry.live.twists, Math.sin(phase))));
    viewer.set_dirty();
    if (running) requestAnimationFrame(animate);
  }

  function later() {
    if (ghost && pm3dof.pose() !== poseOf) stop();
    clearTimeout(waiting);
    waiting = setTimeout(look, PAUSE);
  }

  pm3dof.followers.mode = followMode;
  on("pose", later);
  on("panel", later);
  on("panel", buildModes);
  on("entries", () => animate(0));
  Object.assign(pm3dof, { freeMotion: () => frames, modeAt: (entry, part) => displaced(pm3dof.pose(), entry.live.twists, part) });
})();
