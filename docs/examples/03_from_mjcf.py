"""A mechanism from MuJoCo's format.

MJCF defines loop closures by `connect` and `weld`. Actuators become drives, sites can be the tool. Here the crank of a
four-bar linkage makes one turn; the path of its coupler point is a coupler curve.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, save_figure

MJCF = """
<mujoco model="four_bar"><compiler angle="radian"/><worldbody>
  <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.01"/>
    <body name="coupler" pos="0 0 0.1"><joint name="knee" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.01"/><site name="pen" pos="0.12 0 0.1"/></body></body>
  <body name="rocker" pos="0.25 0 -0.08"><joint name="rocker" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.18" size="0.01"/></body>
</worldbody><equality><connect body1="coupler" body2="rocker" anchor="0.25 0 0"/></equality>
<actuator><motor joint="crank"/></actuator></mujoco>"""
Path("four_bar.xml").write_text(MJCF, encoding="utf-8")

robot = pm.load("four_bar.xml", tool_frame="pen")
print(robot, "- mobility", pm.instantaneous_mobility(robot.home).count)
turn = robot.forward(np.linspace(0.0, 2.0 * np.pi, 361)[:, None])
print(f"loop closed to {turn.residual.max():.0e} m over a whole turn of the crank")

with house_style():
    figure, axes = plt.subplots(figsize=(ONE_COLUMN, 2.6), layout="constrained")
    axes.plot(1e3 * turn.positions[:, 0], 1e3 * turn.positions[:, 2])
    axes.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal", title="Coupler curve")
save_figure(figure, "coupler_curve.png")
