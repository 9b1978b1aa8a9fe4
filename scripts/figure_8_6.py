"""Draw Fig. 8.6: the flow of the error compensation."""

from __future__ import annotations

from pathlib import Path

from pm3dof_pin.figures.compensation_flow import compensation_flow_figure
from pm3dof_pin.figures.style import save_figure

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main() -> None:
    figure = compensation_flow_figure()
    for kind in ("pdf", "png", "svg"):
        print(save_figure(figure, RESULTS / f"figure_8_6.{kind}"))


if __name__ == "__main__":
    main()
