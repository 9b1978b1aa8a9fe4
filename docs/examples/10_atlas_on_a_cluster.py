"""An atlas of the whole workspace, on a cluster.

Any quantity over three to six coordinates as one file with named axes. The work is cut into blocks that any Dask
cluster computes; an interrupted job continues where it stopped. Here the cluster is two processes of this machine.
"""

from pathlib import Path

import pm3dof_pin as pm
from pm3dof_pin.figures.atlas import atlas_pictures
from pm3dof_pin.figures.style import save_figure


def main() -> None:
    """Compute the atlas and draw one of its quantities."""
    from distributed import Client

    robot = pm.load("pm3dof")
    grid = robot.grid(z_e=(0.42, 0.55, 7), theta_x=(-0.7, 0.7, 31), theta_y=(-0.7, 0.7, 31))
    atlas = pm.Atlas(robot, grid, ("felt_stiffness",), Path("atlas.nc"))
    with Client(n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0") as client:
        pm.compute_atlas(atlas, scheduler=client.scheduler.address)
    with pm.open_atlas("atlas.nc") as data:
        felt = 1e-3 * data.felt_stiffness.sel(axis="ry").isel(z_e=3)
        print(dict(data.sizes), f"felt about y: {float(felt.min()):.1f} to {float(felt.max()):.1f} kN m/rad")
        save_figure(atlas_pictures(data.sel(axis=["ry"]), robot)["felt_stiffness_ry"], "atlas.png")


if __name__ == "__main__":
    main()
