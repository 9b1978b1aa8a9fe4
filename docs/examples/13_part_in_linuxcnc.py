"""The part on the controller: the pocket and the strip run in LinuxCNC, and its joints say where the tool was.

LinuxCNC runs without display or root; where it is not installed, the prediction is all.
"""

import subprocess
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import pm3dof_pin as pm
from pm3dof_pin.export.controllers import export_controller
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.paths.controller import controller_limits
from pm3dof_pin.paths.evaluation import PathOptions, evaluate_path
from pm3dof_pin.paths.report import time_picture
from pm3dof_pin.paths.tool_path import read_path

lines = ["G21 G90 G54 G64 P0.01", "G0 X-2.2 Y0 Z1", "G1 Z0 F300", "G3 I-1.8 J0 F600", "G0 Z1", "G0 X2 Y-3"]
for row, x in enumerate(np.linspace(2.0, 5.0, 7)):
    y = np.linspace(-3.0, 3.0, 25)[:: (-1) ** row]
    tilts = 0.3 * np.degrees(np.arctan(0.3 * np.cos(y)))
    lines += [f"G1 X{x:.2f} Y{b:.3f} Z{0.3 * np.sin(b):.4f} A{a:.4f} F900" for a, b in zip(tilts, y, strict=True)]
robot = pm.load("hexapod")
zero = robot.home.tool_placement.homogeneous
Path("part.ngc").write_text("\n".join([*lines, "G0 Z1 A0", "M2", ""]))
Path("run.ngc").write_text("G21\nG10 L2 P1 X0 Y0 Z135\n" + Path("part.ngc").read_text())
export_controller(robot, "linuxcnc", "machine")
limits, path = controller_limits(robot, "machine/hexapod.ini"), read_path(robot, "part.ngc", workpiece={54: zero})
found = evaluate_path(robot, path, PathOptions(limits=limits, spacing=5e-6))
print(f"predicted: {found.summary['time_s']:.1f} s; all within limits: {found.summary['within_limits']}")
save_figure(time_picture(found), "predicted.png")
if Path("/usr/bin/linuxcnc").exists():
    subprocess.run(["sh", "machine/run_sim.sh", "run.ngc"], check=True, capture_output=True)
    time, *joints = np.loadtxt("machine/joints.csv", delimiter=",", skiprows=1).T
    tree = cKDTree(np.stack([found.columns[f"tool_{axis}_m"] for axis in "xyz"], axis=1))
    off = tree.query(robot.forward(1e-3 * np.transpose(joints)).positions)[0][time > 0.5]
    print(f"LinuxCNC: {time[-1] - time[0]:.1f} s, {len(time)} samples, within {1e6 * off.max():.0f} µm of the path")
