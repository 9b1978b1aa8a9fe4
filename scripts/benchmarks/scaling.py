"""Every command on families of large robots: time, memory, and what is refused.

    python scripts/benchmarks/scaling.py [FAMILY [SIZE ...]] ... [--tilted] [--commands NAME ...] [--out FILE.csv]
                                         [--docs PAGE.md]

Each command runs in a process of its own, the first with an empty cache of programs. A command fails if it takes more
than 60 s of processor time or 4 GB, is ended by a signal, or prints a traceback. The exponent says how the time of one
command grows with the size, over the larger half of the sizes. Runs are added to those in the file; with `--docs` the
table of all that stand level is written into a page, between its marks.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from families import FAMILIES

import pm3dof_pin as pm
from pm3dof_pin.kinematics.pose_file import columns_text, readings

SECONDS, BYTES = 60.0, 4e9
START, END = "<!-- scaling -->", "<!-- end of scaling -->"
_OUT_OF_HAND = 3.0  # times the seconds allowed, after which a command is ended

COMMANDS: dict[str, tuple[str, ...]] = {
    "info": ("info",),
    "ik": ("ik", "--configuration", "home"),
    "fk": ("fk", "--configuration", "home"),
    "stiffness": ("stiffness", "--configuration", "home"),
    "fk-all": ("fk", "--all", "--configuration", "home"),
    "statics": ("statics", "--configuration", "home"),
    "equilibrium": ("equilibrium", "--configuration", "home"),
    "modes": ("modes", "--configuration", "home"),
    "receptance": ("receptance", "--configuration", "home"),
    "capability": ("capability", "--configuration", "home"),
    "transmission": ("transmission", "--configuration", "home"),
    "path": ("path", "near.csv", "--effort", "1e9", "--out", "path.csv"),
    "stiffness-map": ("stiffness-map", "--points", "31", "--no-pictures", "--out", "map"),
    "workspace": ("workspace", "--no-picture", "--out", "space"),
    "atlas": ("atlas", "--counts", "3", "--out", "atlas.nc", "--no-pictures"),
    "evaluate": ("evaluate",),
    "error-map": ("error-map", "--out", "errors"),
    "error-parameters": ("error-parameters", "--out", "parameters.yaml"),
    "calibration-plan": ("calibration-plan", "--poses", "40", "--out", "plan.csv"),
    "measure": ("measure", "--poses", "100", "--out", "measured.csv"),
    "calibrate": ("calibrate", "measured.csv", "--method", "lm", "--out", "calibrated"),
    "recheck": ("recheck", "measured.csv", "--calibration", "calibrated", "--no-record"),
    "compensate": ("compensate", "--configuration", "home", "--calibration", "calibrated"),
    "acceptance": ("acceptance", "plan", "positioning", "--out", "targets.csv"),
    "export": ("export", "mjcf", "--out", "exported"),
    "export-c": ("export", "c", "--out", "controller"),
    "export-function": ("export", "function", "--of", "all", "--out", "functions"),
    "view": ("view", "--html", "page.html"),
}


@dataclass(frozen=True)
class Run:
    """One command on one robot."""

    family: str
    size: int
    command: str
    seconds: float  #: processor time
    bytes: float  #: greatest resident size
    status: int  #: exit status; negative for a signal
    said: str  #: last line of standard error, if the status is not 0

    @property
    def verdict(self) -> str:
        """Return 'ok', 'refused', or what failed."""
        if self.status < 0:
            return "stopped" if self.seconds > SECONDS else f"signal {-self.status}"
        last = self.said.split(" ")[0]
        if (last.endswith("Error:") and last != "Error:") or self.status not in (0, 1, 2):
            return "traceback"
        if self.seconds > SECONDS:
            return "slow"
        if self.bytes > BYTES:
            return "large"
        return "ok" if self.status == 0 else "refused"


def write_path(description: Path, file: Path) -> list[str]:
    """Write 200 poses on a line near home that is within limits; return `--line` and its ends.

    It leads towards a random pose, and does not begin at home, a singular pose of the arms.
    """
    robot = pm.load(description)
    there = pm.reachable_poses(robot, 1, np.random.default_rng(0)).coordinates
    way, part = np.linspace(0.5, 1.0, 200)[:, None] * (there - robot.home_coordinates), 0.2
    while not (poses := robot.solve(robot.home_coordinates + part * way, on_failure="nan")).within_limits.all():
        part *= 0.5
    file.write_text(columns_text(readings(robot.coordinates, poses.coordinates)), encoding="utf-8")
    return ["--line", *map(str, poses[[0, -1]].positions.ravel().tolist())]


def run(family: str, size: int, command: str, arguments: Sequence[str], folder: Path) -> Run:
    """Run one command in a folder."""
    environment = os.environ | {"PM3DOF_CACHE_DIR": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "pm3dof_pin", *arguments],
            cwd=folder,
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(_OUT_OF_HAND * SECONDS),) * 2),
        )
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        lines = [line for line in errors.read().splitlines() if line.strip()]
    said = " ".join(lines[-1:]) if process.returncode else ""
    seconds = usage.ru_utime + usage.ru_stime
    return Run(family, size, command, seconds, 1024.0 * usage.ru_maxrss, process.returncode, said.strip("│ "))


def study(family: str, sizes: list[int], commands: list[str], *, tilted: bool) -> Iterator[Run]:
    """Run commands on robots of a family, one size after the other."""
    for size in sizes:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            robot = FAMILIES[family][0](size).write(folder / "robot", tilted=tilted)
            # in a process of its own, whose memory does not count
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
                line = process.submit(write_path, robot, folder / "near.csv").result()
            which = ["--robot", str(robot)]
            own = {"info": [str(robot)], "recheck": [], "acceptance": [*which, *line]}
            for command in commands:
                arguments = [*COMMANDS[command], *own.get(command, which)]
                yield run(f"{family} tilted" if tilted else family, size, command, arguments, folder)


def exponent(runs: list[Run]) -> float:
    """Return how the time of one command grows with the size, over the larger half of the sizes that were done."""
    done = sorted((r.size, r.seconds) for r in runs if r.status == 0)
    sizes, seconds = np.log(np.array(done[len(done) // 2 - (len(done) > 1) :]).reshape(-1, 2)).T
    return float(np.polyfit(sizes, seconds, 1)[0]) if len(sizes) > 1 else float("nan")


def table(runs: list[Run]) -> str:
    """Return a Markdown table: of each command the time at the greatest size of each family, and the exponent."""
    families = [name for name in FAMILIES if any(r.family == name for r in runs)]
    largest = {name: max(r.size for r in runs if r.family == name) for name in families}
    lines = [["processor time [s]", *(f"{name} {largest[name]}" for name in families)], ["---"] * (len(families) + 1)]
    for command in COMMANDS:
        cells = []
        for name in families:
            own = [r for r in runs if (r.family, r.command) == (name, command)]
            last = next((r for r in own if r.size == largest[name]), None)
            growth = exponent(own)
            power = f", n^{growth:.1f}^" if np.isfinite(growth) else ""
            bad = [r for r in sorted(own, key=lambda r: r.size) if r.verdict not in ("ok", "refused")]
            time_taken = (
                "-" if last is None else "refused" if last.verdict == "refused" else f"{last.seconds:.1f}{power}"
            )
            cells.append(f"{bad[0].verdict} from {bad[0].size}" if bad else time_taken)
        lines.append([command, *cells])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def read(path: Path) -> list[Run]:
    """Return the runs of a file."""
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return [
        Run(
            row["family"],
            int(row["size"]),
            row["command"],
            float(row["seconds"]),
            float(row["bytes"]),
            int(row["status"]),
            row["said"],
        )
        for row in rows
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="names, each with sizes after it if not all")
    parser.add_argument("--tilted", action="store_true", help="on a base that is yawed and tilted")
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--out", type=Path)
    parser.add_argument("--docs", type=Path, help="page with the marks <!-- scaling --> and <!-- end of scaling -->")
    arguments = parser.parse_args()
    chosen: dict[str, list[int]] = {}
    earlier = read(arguments.out) if arguments.out and arguments.out.exists() else []
    for word in arguments.families or ([] if earlier else FAMILIES):
        if word.isdigit():
            chosen[list(chosen)[-1]].append(int(word))
        else:
            chosen[word] = []
    runs: list[Run] = []
    for family, sizes in chosen.items():
        for one in study(family, sizes or list(FAMILIES[family][1]), arguments.commands, tilted=arguments.tilted):
            runs.append(one)
            text = f"{one.family:>16} {one.size:3d} {one.command:<17} {one.seconds:7.1f} s {one.bytes / 1e9:5.2f} GB"
            print(f"{text}  {one.verdict:<9} {one.said[:110]}", flush=True)
    print("\nfamily           command            exponent  worst")
    for family in dict.fromkeys(r.family for r in runs):
        for command in arguments.commands:
            own = [r for r in runs if (r.family, r.command) == (family, command)]
            bad = [f"{r.size}: {r.verdict}" for r in own if r.verdict not in ("ok", "refused")]
            print(f"{family:<16} {command:<17} {exponent(own):9.1f}  {', '.join(bad) or '-'}")
    new = {(r.family, r.size, r.command) for r in runs}
    every = [r for r in earlier if (r.family, r.size, r.command) not in new] + runs
    if arguments.out:
        rows = io.StringIO()
        writer = csv.writer(rows)
        writer.writerow(["family", "size", "command", "seconds", "bytes", "status", "verdict", "said"])
        writer.writerows([r.family, r.size, r.command, r.seconds, r.bytes, r.status, r.verdict, r.said] for r in every)
        arguments.out.write_text(rows.getvalue(), encoding="utf-8")
    if arguments.docs:
        page = arguments.docs.read_text(encoding="utf-8")
        start, end = page.index(START) + len(START), page.index(END)
        arguments.docs.write_text(f"{page[:start]}\n{table(every)}\n{page[end:]}", encoding="utf-8")


if __name__ == "__main__":
    start = time.monotonic()
    main()
    print(f"{time.monotonic() - start:.0f} s")
