"""An atlas of the whole workspace, on a cluster.

Any quantity over three to six coordinates as one file with named axes. The work is cut into blocks that any Dask
cluster computes; an interrupted job goes on where it stopped. Here the cluster is two processes of this machine.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pm3dof_pin as pm


def main() -> None:
    """Compute the atlas and draw one of its sections."""
    from distributed import Client

    robot = pm.load("pm3dof")
    grid = robot.grid(z_e=(0.42, 0.55, 14), theta_x=(-0.7, 0.7, 41), theta_y=(-0.7, 0.7, 41))
    atlas = pm.Atlas(robot, grid, ("felt_stiffness",), Path("atlas.nc"))
    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        pm.compute_atlas(atlas, scheduler=client.scheduler.address)
    with pm.open_atlas("atlas.nc") as data:
        felt = 1e-3 * data.felt_stiffness.sel(axis="ry").isel(z_e=7).transpose("theta_y", "theta_x")
        print(dict(data.sizes), f"felt about y: {float(felt.min()):.1f} to {float(felt.max()):.1f} kN m/rad")
        figure, axes = plt.subplots(figsize=(4.2, 3.4), layout="constrained")
        x, y = (np.degrees(data[name]) for name in ("theta_x", "theta_y"))
        figure.colorbar(axes.contourf(x, y, felt, levels=20), label="kN m/rad")
        axes.set(xlabel="theta_x [deg]", ylabel="theta_y [deg]", aspect="equal", title="Stiffness felt about y")
        figure.savefig("atlas.png", dpi=150)


if __name__ == "__main__":
    main()
