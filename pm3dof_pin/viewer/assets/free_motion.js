// Near a singular pose: the motion that becomes free, or is lost, as a swinging ghost of the machine.
"use strict";

hasWebGL && (() => {
  const { viewer, Ghost, on } = pm3dof;
  const PATH = "/free_motion", COLOUR = 0x2a52ff, OPACITY = 0.3;
  const STEP = 1e-4; // of a number, for derivatives [rad, characteristic lengths]
  const SWING = 0.2; // greatest change of a joint [rad, characteristic lengths]
  const FRAMES = 6; // on either side of the pose
  const PERIOD = 2400; // [ms]
  const PAUSE = 150; // after the last move [ms]
  const NEGLIGIBLE = 1e-14; // of the greatest squared motion
  let ghost = null, frames = [], waiting = null, poseOf = null;

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
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    if (still) ghost.place(frames[frames.length - 1]);
    else requestAnimationFrame(animate);
    viewer.set_dirty();
  }

  function stop() {
    if (ghost) ghost.visible = false;
    ghost = poseOf = null;
    frames = [];
    viewer.set_dirty();
  }

  function animate(now) {
    if (!ghost || pm3dof.pose() !== poseOf) return;
    const place = 0.5 - 0.5 * Math.cos(2 * Math.PI * now / PERIOD);
    ghost.place(frames[Math.round(place * (frames.length - 1))]);
    viewer.set_dirty();
    requestAnimationFrame(animate);
  }

  function later() {
    if (ghost && pm3dof.pose() !== poseOf) stop();
    clearTimeout(waiting);
    waiting = setTimeout(look, PAUSE);
  }

  on("pose", later);
  on("panel", later);
  Object.assign(pm3dof, { freeMotion: () => frames });
})();
