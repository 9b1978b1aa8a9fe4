// The tripod in closed form, in double precision: what the sliders of the page need. The same equations as in
// pm3dof_pin/tripod (D. Zhang, Parallel Robotic Machine Tools, Springer 2010, section 8.2, and docs/theory.md), written a
// second time because a page has no Python; tests hold the two against each other.
//
// Poses are [theta_x, theta_y, z_e] in radians and metres, matrices lists of rows, transforms 16 numbers in the order of
// three.js (column after column). All numbers of the machine come from the page's data.
"use strict";

const ClosedForm = (() => {
  // Columns of the leg table, as in pm3dof_pin/viewer/sliders.py.
  const BASE = 0, GUIDE = 3, JOINT = 6, LENGTH = 9, SOCKET = 10, FRAME_X = 13, FRAME_Y = 16, FRAME_Z = 19;
  const GRAVITY = 9.81;

  const vector = (row, column) => [row[column], row[column + 1], row[column + 2]];
  const dot = (a, b) => a.reduce((sum, entry, index) => sum + entry * b[index], 0);
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const norm = (a) => Math.sqrt(dot(a, a));
  const plus = (a, b, factor = 1) => a.map((entry, index) => entry + factor * b[index]);
  const apply = (matrix, a) => matrix.map((row) => dot(row, a));
  const zeros = (rows, columns) => Array.from({ length: rows }, () => new Array(columns).fill(0));

  function multiply(a, b) {
    return a.map((row) => b[0].map((_, column) => row.reduce((sum, entry, k) => sum + entry * b[k][column], 0)));
  }

  // Inverse of a symmetric positive definite matrix, by Gauss and Jordan after its diagonal is scaled to ones: newtons
  // per metre stand beside newton metres per radian.
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
      work[column] = work[column].map((entry) => entry / work[column][column]);
      for (let row = 0; row < n; row++) {
        if (row !== column) work[row] = plus(work[row], work[column], -work[row][column]);
      }
    }
    return work.map((row, i) => row.slice(n).map((entry, j) => entry * scale[i] * scale[j]));
  }

  // Principal values, the least first, and axes as columns of a right-handed frame, of a symmetric 3 x 3 matrix, by
  // Jacobi's rotations.
  function principal(block) {
    const a = block.map((row) => row.slice());
    let v = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    for (let sweep = 0; sweep < 60; sweep++) {
      const rest = Math.hypot(a[0][1], a[0][2], a[1][2]);
      if (rest <= 1e-17 * Math.hypot(a[0][0], a[1][1], a[2][2])) break;
      for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
        if (a[p][q] === 0) continue;
        const ratio = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        const t = (ratio < 0 ? -1 : 1) / (Math.abs(ratio) + Math.sqrt(ratio * ratio + 1));
        const c = 1 / Math.sqrt(t * t + 1), s = t * c;
        for (let k = 0; k < 3; k++) [a[k][p], a[k][q]] = [c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]];
        for (let k = 0; k < 3; k++) [a[p][k], a[q][k]] = [c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]];
        for (let k = 0; k < 3; k++) [v[k][p], v[k][q]] = [c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]];
      }
    }
    const order = [0, 1, 2].sort((i, j) => a[i][i] - a[j][j]);
    const axes = v.map((row) => order.map((column) => row[column]));
    const [x, y, z] = [0, 1, 2].map((column) => axes.map((row) => row[column]));
    if (dot(cross(x, y), z) < 0) axes.forEach((row) => { row[2] = -row[2]; });
    return { values: order.map((i) => a[i][i]), axes };
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

  function assembled(rotation, translation) {
    const [x, y, z] = [0, 1, 2].map((column) => rotation.map((row) => row[column]));
    return [...x, 0, ...y, 0, ...z, 0, ...translation, 1];
  }

  function jointMotion(joint, coordinate) {
    if (joint.type === "prismatic") {
      return assembled([[1, 0, 0], [0, 1, 0], [0, 0, 1]], joint.axis.map((entry) => entry * coordinate));
    }
    const [x, y, z] = joint.axis, c = Math.cos(coordinate), s = Math.sin(coordinate), d = 1 - c;
    return assembled(
      [
        [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
        [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
        [d * x * z - s * y, d * y * z + s * x, c + d * z * z],
      ],
      [0, 0, 0],
    );
  }

  const degrees = (angle) => angle * 180 / Math.PI;

  class Tripod {
    constructor(machine) {
      this.machine = machine;
    }

    // R = Rx(theta_x) Ry(theta_y), (8.3).
    rotation([thetaX, thetaY]) {
      const cx = Math.cos(thetaX), sx = Math.sin(thetaX), cy = Math.cos(thetaY), sy = Math.sin(thetaY);
      return [[cy, 0, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]];
    }

    // Every leg at a pose: u (NaN out of reach), link vector k = D E, arm R p, (8.6), (8.7).
    legs(pose) {
      const rotation = this.rotation(pose);
      return this.machine.legs.map((leg) => {
        const guide = vector(leg, GUIDE), arm = apply(rotation, vector(leg, JOINT));
        const w = plus(plus(arm, [0, 0, pose[2]]), vector(leg, BASE), -1);
        const along = dot(w, guide);
        const radicand = along * along - (dot(w, w) - leg[LENGTH] * leg[LENGTH]);
        const travel = radicand >= 0 ? along - Math.sqrt(radicand) : NaN;
        return { leg, guide, arm, travel, link: plus(w, guide, -travel), socket: apply(rotation, vector(leg, SOCKET)) };
      });
    }

    // Angles of the universal joint at D, from home, and the swing of the spherical joint at E.
    passiveAngles({ leg, link, socket }) {
      const [x, y, z] = [FRAME_X, FRAME_Y, FRAME_Z].map((column) => dot(link, vector(leg, column)));
      const swing = Math.atan2(norm(cross(socket, link)), dot(socket, link));
      return { first: Math.atan2(x, z), second: -Math.atan2(y, Math.hypot(x, z)), swing };
    }

    // The first leg that cannot reach the pose, counted from 1, or 0.
    legOutOfReach(pose) {
      return 1 + this.legs(pose).findIndex(({ travel }) => Number.isNaN(travel));
    }

    // Every joint that the pose takes outside its range, in words.
    brokenLimits(pose) {
      const [uMin, uMax, universal, spherical, zLow, zHigh] = this.machine.bounds;
      const inDegrees = (name, value, low, high) => [name, degrees(value), degrees(low), degrees(high), "deg", 2];
      const entries = [
        inDegrees("platform_x_joint", pose[0], -universal, universal),
        inDegrees("platform_y_joint", pose[1], -universal, universal),
        ["passive_slider_joint", pose[2], zLow, zHigh, "m", 4],
      ];
      this.legs(pose).forEach((leg, index) => {
        const { first, second, swing } = this.passiveAngles(leg);
        entries.push(
          [`slider${index + 1}_joint`, leg.travel, uMin, uMax, "m", 4],
          inDegrees(`universal${index + 1}_first_joint`, first, -universal, universal),
          inDegrees(`universal${index + 1}_second_joint`, second, -universal, universal),
          inDegrees(`spherical${index + 1}`, swing, 0, spherical),
        );
      });
      return entries
        .filter(([, value, low, high]) => !(low <= value && value <= high))
        .map(([name, value, low, high, unit, digits]) => {
          const [v, l, h] = [value, low, high].map((number) => number.toFixed(digits));
          return `${name} at ${v} ${unit}, outside ${l} .. ${h} ${unit}`;
        });
    }

    // Coordinate of every joint of the URDF, by name.
    jointCoordinates(pose) {
      const coordinates = {
        platform_x_joint: pose[0],
        platform_y_joint: pose[1],
        passive_slider_joint: pose[2] - this.machine.home_height,
      };
      this.legs(pose).forEach((leg, index) => {
        const { first, second } = this.passiveAngles(leg);
        coordinates[`slider${index + 1}_joint`] = leg.travel - this.machine.home_travel;
        coordinates[`universal${index + 1}_first_joint`] = first;
        coordinates[`universal${index + 1}_second_joint`] = second;
      });
      return coordinates;
    }

    // Placement of every joint of the tree in the world.
    jointPlacements(pose) {
      const coordinates = this.jointCoordinates(pose);
      const placements = [];
      for (const joint of this.machine.joints) {
        if (joint.parent < 0) {
          placements.push(joint.placement);
          continue;
        }
        const moved = product(joint.placement, jointMotion(joint, coordinates[joint.name]));
        placements.push(product(placements[joint.parent], moved));
      }
      return placements;
    }

    // Greatest distance of two points that a loop closure joins, along the tree of the URDF [m].
    closureError(placements) {
      const point = ({ joint, placement }) => product(placements[joint], placement).slice(12, 15);
      return Math.max(...this.machine.closures.map(([a, b]) => norm(plus(point(a), point(b), -1))));
    }

    // Unit wrench, cosine to the guide and stiffness of every leg: actuator and link in series.
    legSprings(pose) {
      const [actuator, link] = this.machine.springs;
      return this.legs(pose).map((leg) => {
        const direction = leg.link.map((entry) => entry / leg.leg[LENGTH]);
        const cosine = dot(direction, leg.guide);
        const stiffness = 1 / (cosine * cosine / actuator + 1 / link);
        return { wrench: [...direction, ...cross(leg.arm, direction)], cosine, stiffness };
      });
    }

    // Stiffness of the passive leg alone, S^T (S C_b S^T)^-1 S, a cantilever that ends in a universal joint.
    passiveLegStiffness(pose) {
      const [, , bending, torsion, clamp] = this.machine.springs;
      const length = pose[2] - clamp, sx = Math.sin(pose[0]), cx = Math.cos(pose[0]);
      const beam = zeros(6, 6);
      beam[0][0] = beam[1][1] = length ** 3 / (3 * bending);
      beam[3][3] = beam[4][4] = length / bending;
      beam[5][5] = length / torsion;
      beam[0][4] = beam[4][0] = length ** 2 / (2 * bending);
      beam[1][3] = beam[3][1] = -(length ** 2) / (2 * bending);
      const held = [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 0, 0, -sx, cx]];
      const transposed = held[0].map((_, column) => held.map((row) => row[column]));
      const stiffness = inverse(multiply(multiply(held, beam), transposed));
      return multiply(multiply(transposed, stiffness), held);
    }

    // The 6 x 6 stiffness at the tool, axes of the base, or null at or below the clamp of the passive leg.
    stiffness(pose) {
      if (!(pose[2] > this.machine.springs[4])) return null;
      const total = this.passiveLegStiffness(pose);
      for (const { wrench, stiffness } of this.legSprings(pose)) {
        for (let i = 0; i < 6; i++) {
          for (let j = 0; j < 6; j++) total[i][j] += stiffness * wrench[i] * wrench[j];
        }
      }
      return total;
    }

    // The 3 x 3 block that an ellipsoid shows, as pm3dof_pin.viewer.ellipsoids.block does.
    block(stiffness, { motion, of, others }) {
      const start = motion === "translation" ? 0 : 3;
      const cut = (matrix) => matrix.slice(start, start + 3).map((row) => row.slice(start, start + 3));
      const held = others === "held";
      const block = cut(held ? stiffness : inverse(stiffness));
      return held === (of === "stiffness") ? block : inverse(block);
    }

    // Share of each leg, actuator and link together, and last of the passive leg, in the deflection under a wrench.
    legShares(pose, stiffness, wrench) {
      const twist = apply(inverse(stiffness), wrench);
      const total = dot(wrench, twist);
      const shares = this.legSprings(pose).map((leg) => leg.stiffness * dot(leg.wrench, twist) ** 2 / total);
      return [...shares, 1 - shares.reduce((sum, share) => sum + share, 0)];
    }

    // Actuator forces that hold three legs and the platform against gravity, by virtual work on the centres of mass:
    // sliders at D, links at mid-length, platform and passive leg with z_e. Null for another number of legs.
    holdingForces(pose) {
      const { slider, link, platform } = this.machine.masses;
      const legs = this.legs(pose);
      if (legs.length !== 3) return null;
      const rows = [], work = [0, 0, platform];
      const omegas = [[1, 0, 0], [0, Math.cos(pose[0]), Math.sin(pose[0])]];
      for (const { guide, arm, link: k } of legs) {
        // columns of J_i, (8.5), and the row of J_t, (8.9)
        const columns = [...omegas.map((omega) => cross(omega, arm)), [0, 0, 1]];
        const row = columns.map((column) => dot(k, column) / dot(k, guide));
        rows.push(row);
        for (let j = 0; j < 3; j++) {
          work[j] += slider * guide[2] * row[j] + 0.5 * link * (guide[2] * row[j] + columns[j][2]);
        }
      }
      return solveTransposed(rows, work.map((entry) => GRAVITY * entry));
    }
  }

  // x with A^T x = b, 3 x 3, by Cramer's rule.
  function solveTransposed(rows, b) {
    const columns = rows; // of A^T
    const determinant = (m) => dot(m[0], cross(m[1], m[2]));
    const whole = determinant(columns);
    return [0, 1, 2].map((index) => determinant(columns.map((c, j) => (j === index ? b : c))) / whole);
  }

  // The transform that makes a unit sphere an ellipsoid, or a unit arrow an arrow.
  function stretched(axes, lengths, position) {
    return assembled(axes.map((row) => row.map((entry, column) => entry * lengths[column])), position);
  }

  // A rotation that takes the z axis to a direction, as rows.
  function turnZTo(direction) {
    const size = norm(direction), z = direction.map((entry) => entry / size);
    const sizes = z.map(Math.abs), least = sizes.indexOf(Math.min(...sizes));
    const beside = cross([0, 1, 2].map((index) => (index === least ? 1 : 0)), z);
    const x = beside.map((entry) => entry / norm(beside)), y = cross(z, x);
    return [0, 1, 2].map((index) => [x[index], y[index], z[index]]);
  }

  return { Tripod, principal, inverse, product, stretched, turnZTo, degrees };
})();
