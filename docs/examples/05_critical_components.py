"""Which part to make stiffer?

Every spring has a share in the deflection under a load; the shares add up to one. So making a spring ten
per cent stiffer removes about a tenth of its share.
"""

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.elastic.shares import shares
from pm3dof_pin.figures.style import TWO_COLUMNS, house_style, save_figure, spring_colors

robot = pm.load("pm3dof")
model = pm.ElasticModel(robot)
pose = robot.solve([np.radians(20.0), np.radians(-10.0), 0.52]).configuration()
behaviour = pm.cartesian_compliance(model, pose)

loads = {"force along x": 0, "force along z": 2, "moment about x": 3, "moment about z": 5}
table = np.array([shares(behaviour.contributions, np.eye(6)[axis]) for axis in loads.values()])
for load, row in zip(loads, table, strict=True):
    worst = int(np.argmax(row))
    print(f"{load:15s} {model.spring_names[worst]:12s} gives {100 * row[worst]:5.1f} % of the deflection")

with house_style():
    figure, axes = plt.subplots(figsize=(TWO_COLUMNS, 2.4), layout="constrained")
    left = np.zeros(len(loads))
    for name, color, column in zip(model.spring_names, spring_colors(table.shape[1]), table.T, strict=True):
        axes.barh(list(loads), 100.0 * column, left=100.0 * left, color=color, label=name.replace("_", " "))
        left += column
    axes.set(xlabel="share in the deflection [%]", xlim=(0, 100))
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
save_figure(figure, "critical_components.png")
