// A robot that moves with closed loops, for the sliders of the page. Robot-specific arithmetic is in the functions of
// `programs`, traced from its model by Python and printed before this; here is what is common to all robots: moving from
// pose to pose, and the linear algebra of ellipsoids.
//
// Numbers are in SI units and radians, matrices lists of rows, transforms 16 numbers in column-major order, as in
// three.js.
"use strict";

const Robot = (() => {
  const JUMP = 0.5; // largest step of a joint from a random start [rad, characteristic lengths]
  const NEARLY_CLOSED = 1e-8; // from here one quadratic step reaches rounding [m, rad]
  const FAR_STEPS = 60; // from a random start
  const PULL = 0.1; // largest change of a coordinate by a pull [rad, characteristic lengths]
  const PULL_STEP = 1e-5; // for the derivative by a coordinate, in characteristic lengths or 0.6 rad
  const PULL_DAMPING = 0.02; // compliance of the dragged point near singular poses [characteristic lengths]
  const SINGULAR = 1e-12; // smaller pivots of a scaled matrix are rounding
  const AT_LIMIT = 1e-3; // part of a range that counts as its end
  const RIGID = 1e-14; // relative to the greatest squared velocity: less is rounding
  const NO_DEFLECTION = 1e-13; // relative to the greatest compliance of the same unit, as in pm3dof_pin/viewer/ellipsoids.py
  const SHARE_STEP = 1e-4; // relative change of a spring, for the derivative that gives its share

  const dot = (a, b) => a.reduce((sum, entry, index) => sum + entry * b[index], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const norm = (a) => Math.sqrt(dot(a, a));
  const apply = (matrix, a) => matrix.map((row) => dot(row, a));

  // Write zero without a sign.
  const fixed = (number, digits) => number.toFixed(digits).replace(/^-(?=[0.]*$)/, "");

  // Inverse of a symmetric positive definite matrix, by Gauss-Jordan after scaling to a unit diagonal, since units are
  // mixed; NaN if it is singular, as the compliance of a wrist.
  function inverse(matrix) {
    const n = matrix.length;
    const scale = matrix.map((row, i) => 1 / Math.sqrt(row[i]));
    const work = matrix.map((row, i) => [
      ...row.map((entry, j) => entry * scale[i] * scale[j]),
      ...row.map((_, j) => (i === j ? 1 : 0)),
    ]);
    for (let column = 0; column < n; column++) {
      let pivot = column;
      for (let row = column + 1; row < n; row++) {
        if (Math.abs(work[row][column]) > Math.abs(work[pivot][column])) pivot = row;
      }
      [work[column], work[pivot]] = [work[pivot], work[column]];
      if (!(Math.abs(work[column][column]) > SINGULAR)) return matrix.map((row) => row.map(() => NaN));
      work[column] = work[column].map((entry) => entry / work[column][column]);
      for (let row = 0; row < n; row++) {
        const factor = work[row][column];
        if (row !== column) work[row] = work[row].map((entry, index) => entry - factor * work[column][index]);
      }
    }
    return work.map((row, i) => row.slice(n).map((entry, j) => entry * scale[i] * scale[j]));
  }

  // Eigenvalues of a symmetric matrix and axes as columns, by Jacobi rotations.
  function eigen(matrix) {
    const a = matrix.map((row) => row.slice()), n = a.length;
    const v = a.map((_, i) => a.map((__, j) => (i === j ? 1 : 0)));
    for (let sweep = 0; sweep < 60; sweep++) {
      const rest = Math.hypot(...a.flatMap((row, i) => row.slice(i + 1)));
      if (rest <= 1e-17 * Math.hypot(...a.map((row, i) => row[i]))) break;
      for (let p = 0; p < n; p++) {
        for (let q = p + 1; q < n; q++) {
          if (a[p][q] === 0) continue;
          const ratio = (a[q][q] - a[p][p]) / (2 * a[p][q]);
          const t = (ratio < 0 ? -1 : 1) / (Math.abs(ratio) + Math.sqrt(ratio * ratio + 1));
          const c = 1 / Math.sqrt(t * t + 1), s = t * c;
          for (let k = 0; k < n; k++) [a[k][p], a[k][q]] = [c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]];
          for (let k = 0; k < n; k++) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
          for (let k = 0; k < n; k++) [v[k][p], v[k][q]] = [c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]];
        }
      }
    }
    return { values: a.map((row, k) => row[k]), axes: v };
  }

  // Ascending principal values of a symmetric 3 x 3 matrix, and axes as columns of a right-handed frame.
  function principal(block) {
    const { values, axes: v } = eigen(block);
    const order = [0, 1, 2].sort((i, j) => values[i] - values[j]);
    const axes = v.map((row) => order.map((column) => row[column]));
    const [x, y, z] = [0, 1, 2].map((column) => axes.map((row) => row[column]));
    if (dot(cross(x, y), z) < 0) axes.forEach((row) => { row[2] = -row[2]; });
    return { values: order.map((i) => values[i]), axes };
  }

  function product(a, b) {
    const result = new Array(16).fill(0);
    for (let column = 0; column < 4; column++) {
      for (let row = 0; row < 4; row++) {
        for (let k = 0; k < 4; k++) result[4 * column + row] += a[4 * k + row] * b[4 * column + k];
      }
    }
    return result;
  }

  // The transform from a unit sphere to an ellipsoid, or from a unit arrow to an arrow.
  function stretched(axes, lengths, position) {
    const [x, y, z] = [0, 1, 2].map((column) => axes.map((row) => row[column] * lengths[column]));
    return [...x, 0, ...y, 0, ...z, 0, ...position, 1];
  }

  // A rotation from the z axis to a direction, as rows.
  function turnZTo(direction) {
    const size = norm(direction), z = direction.map((entry) => entry / size);
    const sizes = z.map(Math.abs), least = sizes.indexOf(Math.min(...sizes));
    const beside = cross([0, 1, 2].map((index) => (index === least ? 1 : 0)), z);
    const x = beside.map((entry) => entry / norm(beside)), y = cross(z, x);
    return [0, 1, 2].map((index) => [x[index], y[index], z[index]]);
  }

  class Pose {
    // The result of the program `place` for joint positions.
    constructor(robot, q) {
      this.q = q;
      this.robot = robot;
      this.numbers = new Float64Array(robot.programs.place_size);
      robot.programs.place(q, this.numbers);
    }

    // Rows of rotation and translation of a joint, shape 3 x 4; the tool follows the joints.
    rows(index) {
      return [0, 4, 8].map((first) => [...this.numbers.subarray(12 * index + first, 12 * index + first + 4)]);
    }

    placement(index) {
      const rows = this.rows(index);
      return [0, 1, 2, 3].flatMap((column) => [...rows.map((row) => row[column]), column === 3 ? 1 : 0]);
    }

    translation(index) {
      return this.rows(index).map((row) => row[3]);
    }

    get tool() {
      return this.translation(this.robot.data.tool);
    }

    // Greatest error of the loop closures [m, rad].
    get residual() {
      return this.numbers[12 * this.robot.data.placements];
    }

    swing(index) {
      const first = 12 * this.robot.data.placements + 1 + 2 * index;
      return Math.atan2(Math.sqrt(this.numbers[first]), this.numbers[first + 1]);
    }

    // x, y, z, rx, ry, rz of the tool, R = Rx Ry Rz.
    get toolComponents() {
      const R = this.rows(this.robot.data.tool);
      return [
        R[0][3], R[1][3], R[2][3],
        Math.atan2(-R[1][2], R[2][2]),
        Math.atan2(R[0][2], Math.hypot(R[1][2], R[2][2])),
        Math.atan2(-R[0][1], R[0][0]),
      ];
    }

    // Values of the numbers of a set: coordinates or commands.
    values(set) {
      const tool = set.numbers.some((number) => number.tool !== null) ? this.toolComponents : null;
      return set.numbers.map(({ joint, tool: component, scale, offset }) => {
        if (joint === null) return scale * tool[component] + offset;
        const { index, continuous } = joint;
        return scale * (continuous ? Math.atan2(this.q[index + 1], this.q[index]) : this.q[index]) + offset;
      });
    }

    // Limits of joints and closures, with their values.
    limitReadings() {
      const { joints, swings } = this.robot.data.limits;
      return [
        ...joints.map((limit) => [limit, this.q[limit.index]]),
        ...swings.map((limit, index) => [limit, this.swing(index)]),
      ];
    }

    // Joints of bodies that are at or beyond a limit; a swing of zero is none.
    stoppedJoints() {
      const inside = ([{ index, lower, upper }, value]) => {
        const room = AT_LIMIT * (upper - lower), isSwing = index === undefined;
        return lower === upper || ((isSwing || lower + room < value) && value < upper - room);
      };
      return new Set(this.limitReadings().filter((reading) => !inside(reading)).map(([{ joint }]) => joint));
    }

    // Descriptions of all joints and closures outside their ranges.
    brokenLimits() {
      return this.limitReadings()
        .filter(([{ lower, upper }, value]) => !(lower - 1e-9 <= value && value <= upper + 1e-9))
        .map(([{ name, unit, factor, offset, digits, lower, upper }, value]) => {
          const shown = (number) => fixed(factor * number + offset, digits);
          const ends = factor < 0 ? [upper, lower] : [lower, upper];
          return `${name} at ${shown(value)} ${unit}, outside ${ends.map(shown).join(" .. ")} ${unit}`;
        });
    }
  }

  class Robot {
    constructor(data, functions) {
      this.data = data;
      this.programs = functions;
    }

    pose(q) {
      return new Pose(this, Float64Array.from(q));
    }

    home() {
      return this.pose(this.data.home);
    }

    // The pose at values of a set's numbers in the branch of the given pose, by the walk that Python and controllers use;
    // null if it is out of reach.
    moved(pose, set, values) {
      const q = new Float64Array(pose.q.length);
      return this.programs[set.program](pose.q, this.given(set, values), q) === 0 ? new Pose(this, q) : null;
    }

    // The numbers that programs take for values of a set's numbers.
    given(set, values) {
      return set.order.map((k) => (values[k] - set.numbers[k].offset) / set.numbers[k].scale);
    }

    // All poses at values of a set's numbers that damped steps from random starts find: other assembly modes of the same
    // machine. The search may miss some; those found are closed.
    assemblies(set, values, starts = 150) {
      const found = [];
      for (let start = 0; start < starts; start++) {
        const q = this.settled(this.randomPose(), set, values);
        if (!q) continue;
        const pose = new Pose(this, this.unwound(q, set)), places = pose.numbers.subarray(0, 12 * this.data.placements);
        const same = ({ numbers }) => places.every((entry, k) => Math.abs(entry - numbers[k]) < 1e-5 * (this.data.length + 1));
        if (pose.residual < NEARLY_CLOSED && !found.some(same)) found.push(pose);
      }
      return found.sort((a, b) => a.brokenLimits().length - b.brokenLimits().length);
    }

    // Random joint positions, within the limits if there are any.
    randomPose() {
      const q = Float64Array.from(this.data.home);
      this.data.joints.forEach(({ index, size, slides }) => {
        const limit = this.data.limits.joints.find((each) => each.index === index);
        const [low, high] = limit ? [limit.lower, limit.upper] : slides ? [q[index] - this.data.length, q[index] + this.data.length] : [-Math.PI, Math.PI];
        if (size === 1) q[index] = low + Math.random() * (high - low);
        else for (let k = 0; k < size; k++) q[index + k] = Math.random() * 2 - 1;
      });
      return this.normalised(q);
    }

    // Remove whole turns from angles that a set does not give: random starts wind joints up.
    unwound(q, set) {
      const given = set.numbers.filter(({ joint }) => joint).map(({ joint }) => joint.index);
      this.data.joints.filter(({ index, size, slides }) => size === 1 && !slides && !given.includes(index)).forEach(({ index }) => {
        const limit = this.data.limits.joints.find((each) => each.index === index);
        const middle = limit ? (limit.lower + limit.upper) / 2 : this.data.home[index];
        q[index] -= 2 * Math.PI * Math.round((q[index] - middle) / (2 * Math.PI));
      });
      return q;
    }

    // Normalise pairs (cos, sin) and quaternions.
    normalised(q) {
      this.data.joints.filter(({ size }) => size > 1).forEach(({ index, size }) => {
        const part = q.subarray(index, index + size), length = norm([...part]) || 1;
        part.forEach((entry, k) => { part[k] = entry / length; });
      });
      return q;
    }

    // Newton's method with limited steps, for distant starts; null if it does not settle.
    settled(start, set, values) {
      const close = this.programs[`${set.program}_step`], n = start.length, given = this.given(set, values);
      const output = new Float64Array(n + 3);
      let q = start;
      for (let step = 0; step < FAR_STEPS; step++) {
        close(Float64Array.from([...q, 1, 0, ...given]), output);
        const jump = output[n + 1], residual = output[n + 2];
        if (!Number.isFinite(jump)) return null;
        const part = step ? Math.min(1, JUMP / jump) : 1; // the first step places the given joints
        q = this.normalised(q.map((entry, k) => entry + part * (output[k] - entry)));
        if (step && residual < NEARLY_CLOSED && jump < NEARLY_CLOSED) return q;
      }
      return null;
    }

    // C at the tool, twist = C wrench, or null if there is none or it is in doubt.
    compliance(pose, springs = this.programs.springs) {
      if (!this.programs.compliance || this.data.lengths.some(({ index, at_zero }) => !(pose.q[index] + at_zero > 0))) return null;
      const numbers = new Float64Array(this.programs.compliance_size);
      this.programs.compliance(pose.q, springs, numbers);
      if (numbers[36] !== 1) return null;
      return [0, 6, 12, 18, 24, 30].map((first) => [...numbers.subarray(first, first + 6)]);
    }

    // Twists of the tool for one standard deviation of each error, and for one unit of each command, as rows; null if
    // there are none or they are in doubt.
    motions(pose) {
      if (!this.programs.motion) return null;
      const { sigmas, commands } = this.data;
      const numbers = new Float64Array(this.programs.motion_size);
      this.programs.motion(pose.q, numbers);
      if (numbers[numbers.length - 1] !== 1) return null;
      const part = (first, factors) =>
        [0, 1, 2, 3, 4, 5].map((row) => factors.map((factor, k) => factor * numbers[first + row * factors.length + k]));
      return { errors: part(0, sigmas), commands: part(6 * sigmas.length, commands.map(({ scale }) => 1 / scale)) };
    }

    // Principal values and axes of an ellipsoid, or a text if there is none; C at the tool is used if given.
    ellipsoid(pose, live, compliance) {
      const { motion, of } = live;
      if (of === "stiffness" || of === "compliance") {
        if (!compliance) return "no stiffness in this pose";
        const block = this.block(compliance, live);
        return block.flat().every(Number.isFinite) ? principal(block) : "not in this pose: some motion is rigid";
      }
      const motions = this.motions(pose);
      if (!motions) return "not in this pose: near a singular one";
      if (of === "error" && !this.data.sigmas.length) return "no tolerances are given";
      const rows = motions[of === "error" ? "errors" : "commands"].slice(...(motion === "translation" ? [0, 3] : [3, 6]));
      const { values, axes } = principal(rows.map((a) => rows.map((b) => dot(a, b))));
      const roots = values.map((value) => (value > RIGID * values[2] ? Math.sqrt(value) : 0));
      if (of !== "force") return { values: roots, axes };
      if (!roots[0]) return "not in this pose: the tool does not move in some direction";
      return { values: roots.map((value) => 1 / value).reverse(), axes: axes.map(([x, y, z]) => [z, y, -x]) };
    }

    // Slowest and fastest tool motion for commands of unit norm, in characteristic lengths; null if in doubt. The fastest
    // is unbounded near a pose at which the drives lose control of the platform, the slowest vanishes where they cannot
    // move it.
    gains(pose) {
      const motions = this.motions(pose);
      if (!motions) return null;
      const units = this.data.commands.map(({ unit }) => (unit === "m" ? this.data.length : 1));
      const scaled = motions.commands.map((row, i) =>
        row.map((entry, k) => entry * units[k] / (i < 3 ? this.data.length : 1)));
      const columns = units.map((_, k) => scaled.map((row) => row[k]));
      const values = eigen(columns.map((a) => columns.map((b) => dot(a, b)))).values.sort((a, b) => b - a);
      return [Math.sqrt(Math.max(0, values[Math.min(6, values.length) - 1])), Math.sqrt(values[0])];
    }

    // The pose with a point of a joint's body nearer to a target, by damped least squares over a set; null if there is
    // none.
    pulled(pose, set, joint, local, target) {
      const place = (p) => p.rows(joint).map((row) => row[0] * local[0] + row[1] * local[1] + row[2] * local[2] + row[3]);
      const values = pose.values(set), point = place(pose);
      const missing = target.map((entry, i) => entry - point[i]);
      const sizes = set.numbers.map(({ unit, scale }) => (unit === "m" ? this.data.length : 0.6) * Math.abs(scale));
      const columns = set.numbers.map((_, k) => {
        const beside = values.slice();
        beside[k] += PULL_STEP * sizes[k];
        const found = this.moved(pose, set, beside);
        if (!found) return [0, 0, 0];
        return place(found).map((entry, i) => (entry - point[i]) / PULL_STEP);
      });
      // y = J^T (J J^T + damping)^-1 missing
      const damping = (PULL_DAMPING * this.data.length) ** 2;
      const square = [0, 1, 2].map((i) => [0, 1, 2].map((j) =>
        columns.reduce((sum, column) => sum + column[i] * column[j], i === j ? damping : 0)));
      const weights = apply(inverse(square), missing);
      const wanted = values.map((value, k) => {
        const { least, greatest, factor } = set.numbers[k].slider;
        const change = Math.max(-PULL, Math.min(PULL, dot(columns[k], weights)));
        return Math.min(greatest / factor, Math.max(least / factor, value + change * sizes[k]));
      });
      return this.moved(pose, set, wanted);
    }

    // The 3 x 3 block that an ellipsoid shows, as pm3dof_pin.viewer.ellipsoids.block.
    block(compliance, { motion, of, others }) {
      const { basis, translations } = this.data, moves = motion === "translation";
      const part = moves ? [0, translations] : [translations], rows = moves ? [0, 3] : [3, 6];
      const cut = (matrix) => matrix.slice(...part).map((row) => row.slice(...part));
      const held = others === "held";
      const inSpace = basis.map((a) => basis.map((b) => dot(a, apply(compliance, b))));
      const kept = cut(held ? inverse(inSpace) : inSpace), asIs = held === (of === "stiffness");
      const softness = asIs || held ? [1] : eigen(kept).values; // of a stiffness that is the inverse of a compliance
      const isRigid = Math.min(...softness) <= NO_DEFLECTION * Math.max(...softness);
      if (isRigid) return [0, 1, 2].map(() => [NaN, NaN, NaN]);
      const block = asIs ? kept : inverse(kept), axes = basis.slice(...part).map((a) => a.slice(...rows));
      return [0, 1, 2].map((i) => [0, 1, 2].map((j) =>
        block.reduce((sum, row, k) => sum + axes[k][i] * row.reduce((inner, entry, l) => inner + entry * axes[l][j], 0), 0)));
    }

    // Number of principal values of an ellipsoid: fewer in a plane.
    count(motion) {
      return motion === "translation" ? this.data.translations : this.data.basis.length - this.data.translations;
    }

    // Share of each spring in the deflection under a wrench: the logarithmic derivative by the spring's compliance, since
    // the springs minimise their energy.
    shares(pose, springs, wrench) {
      const deflection = (places, factor) => {
        const numbers = this.programs.springs.slice();
        places.forEach((place) => { numbers[place] *= factor; }); // roots of its compliance
        return Math.log(dot(wrench, apply(this.compliance(pose, numbers), wrench)));
      };
      return springs.map((places) => {
        const change = deflection(places, 1 + SHARE_STEP) - deflection(places, 1 - SHARE_STEP);
        return change / (2 * Math.log((1 + SHARE_STEP) / (1 - SHARE_STEP)));
      });
    }

    // Actuator forces that hold the weight; null if there are none, as at a singular pose.
    holdingForces(pose) {
      if (!this.programs.holding) return null;
      const numbers = new Float64Array(this.programs.holding_size);
      this.programs.holding(pose.q, numbers);
      const forces = [...numbers.subarray(0, numbers.length - 1)];
      return numbers[forces.length] > this.data.sound_pivot && forces.every(Number.isFinite) ? forces : null;
    }

    // Origin and direction of each actuated joint's axis in the world.
    actuatorAxes(pose) {
      return this.data.actuators.map(({ joint, axis }) => {
        const rows = pose.rows(joint);
        return { origin: rows.map((row) => row[3]), direction: rows.map((row) => dot(row.slice(0, 3), axis)) };
      });
    }
  }

  return Object.assign(Robot, { apply, eigen, fixed, principal, inverse, product, stretched, turnZTo });
})();
