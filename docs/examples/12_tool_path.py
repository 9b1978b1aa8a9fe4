"""A part judged before it is cut: a pocket and a freeform strip, from G-code to commands that allow for the force.

The program is written here as a CAM system would write it. The strip is wavy, and the tool stays normal to it. Then the
workpiece is placed where the machine is stiffest, and the whole path is judged.
"""

from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.paths.evaluation import PathOptions, evaluate_path
from pm3dof_pin.paths.placement import place_path
from pm3dof_pin.paths.report import path_picture, path_report, time_picture
from pm3dof_pin.paths.tool_path import read_path

lines = ["G21 G90 G54 G64 P0.01", "G0 X-4 Y0 Z1"]
for radius in (1.0, 1.8):  # a round pocket in two passes
    lines += ["G1 X-4 Y0 Z0 F300", f"G1 X{radius - 4} F600", f"G3 I{-radius} J0"]
lines += ["G0 Z1", "G0 X2 Y-3"]
for row, x in enumerate(np.linspace(2.0, 5.0, 7)):  # a wavy strip, row by row
    y = np.linspace(-3.0, 3.0, 25)[:: 1 if row % 2 == 0 else -1]
    height, slope = 0.3 * np.sin(y), np.degrees(np.arctan(0.3 * np.cos(y)))
    lines += [f"G1 X{x:.3f} Y{b:.4f} Z{c:.4f} A{a:.4f} F900" for a, b, c in zip(0.3 * slope, y, height, strict=True)]
Path("part.ngc").write_text("\n".join([*lines, "G0 Z1 A0", "M2", ""]))

robot, zero = pm.load("hexapod"), np.eye(4)
zero[2, 3] = 0.134
options = PathOptions(force=[10.0, 20.0, 60.0])
place = place_path(robot, read_path(robot, "part.ngc", workpiece={54: zero}), "stiffest", options)
found = evaluate_path(robot, read_path(robot, "part.ngc", workpiece=place.workpiece), options)
summary = found.summary
print(f"zero at {np.round(1e3 * place.workpiece[54][:3, 3], 2)} mm; all within limits: {summary['within_limits']}")
print(f"{summary['points']} points, {summary['time_s']:.1f} s, {1e6 * summary['greatest_deflection_m']:.2f} µm at most")
Path("part.html").write_text(path_report(found, "part.ngc", place), encoding="utf-8")
save_figure(path_picture(found), "part.png")
save_figure(time_picture(found), "part_in_time.png")
