"""How far does it deflect under a large load?

The stiffness is the slope at zero load. Under large loads the pose changes: the equilibrium is followed with the exact
tangent stiffness, all loops closed. Here a load presses down, inclined by half a degree.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.elastic.loaded import load_deflection
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, save_figure

robot = pm.load("pm3dof")
model = pm.ElasticModel(robot)
wrench = np.array([0.01, 0.0, -1.0, 0.0, 0.0, 0.0])
push = pm.Loads(wrenches={"O_e": wrench})
forces = np.linspace(0.0, 110e3, 45)
curve = load_deflection(model, robot.home, push, forces)
moved = 1e3 * np.array([state.displacement()[0] for state in curve])
slope = 1e3 * pm.cartesian_compliance(model, robot.home).compliance[0] @ wrench
print(f"at {1e-3 * forces[-1]:.0f} kN {moved[-1]:.2f} mm sideways, {slope * forces[-1]:.2f} mm by the slope alone")

with house_style():
    figure, axes = plt.subplots(figsize=(ONE_COLUMN, 2.6), layout="constrained")
    axes.plot(moved, 1e-3 * forces, label="equilibria")
    axes.plot(slope * forces, 1e-3 * forces, "--", color="grey", label="slope at no load")
    axes.set(xlabel="sideways deflection [mm]", ylabel="load [kN]")
    axes.legend()
save_figure(figure, "loaded_deflection.png")
