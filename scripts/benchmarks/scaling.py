"""Every command on families of large robots: time, memory, and what is refused.

    python scripts/benchmarks/scaling.py [FAMILY | FAMILY SIZE] ... [--commands NAME ...] [--out FILE.csv]

Each command runs in a process of its own, the first with an empty cache of programs. A command fails if it takes more
than 60 s of processor time or 4 GB, is ended by a signal, or prints a traceback. The exponent says how the time of one
command grows with the size, over the larger half of the sizes.
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
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from families import FAMILIES

SECONDS, BYTES = 60.0, 4e9
_OUT_OF_HAND = 3.0  # times the seconds allowed, after which a command is ended

COMMANDS: dict[str, tuple[str, ...]] = {
    "info": ("info",),
    "fk": ("fk", "--configuration", "home"),
    "stiffness": ("stiffness", "--configuration", "home"),
    "statics": ("statics", "--configuration", "home"),
    "modes": ("modes", "--configuration", "home"),
    "capability": ("capability", "--configuration", "home"),
    "stiffness-map": ("stiffness-map", "--points", "31", "--no-pictures", "--out", "map"),
    "workspace": ("workspace", "--no-picture", "--out", "space"),
    "atlas": ("atlas", "--counts", "3", "--out", "atlas.nc", "--no-pictures"),
    "evaluate": ("evaluate",),
    "error-map": ("error-map", "--out", "errors"),
    "calibration-plan": ("calibration-plan", "--poses", "40", "--out", "plan.csv"),
    "measure": ("measure", "--poses", "100", "--out", "measured.csv"),
    "calibrate": ("calibrate", "measured.csv", "--method", "lm", "--out", "calibrated"),
    "export": ("export", "mjcf", "--out", "exported"),
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


def run(family: str, size: int, command: str, robot: Path, folder: Path) -> Run:
    """Run one command on a robot in a folder."""
    environment = os.environ | {"PM3DOF_CACHE_DIR": str(folder / "cache"), "OMP_NUM_THREADS": "1"}
    arguments = COMMANDS[command]
    own = [str(robot)] if command == "info" else ["--robot", str(robot)]
    with tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "pm3dof_pin", *arguments, *own],
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


def study(family: str, sizes: list[int], commands: list[str]) -> Iterator[Run]:
    """Run commands on robots of a family, one size after the other."""
    for size in sizes:
        with tempfile.TemporaryDirectory() as temporary:
            robot = FAMILIES[family][0](size).write(Path(temporary) / "robot")
            for command in commands:
                yield run(family, size, command, robot, Path(temporary))


def exponent(runs: list[Run]) -> float:
    """Return how the time of one command grows with the size, over the larger half of the sizes that were done."""
    done = sorted((r.size, r.seconds) for r in runs if r.status == 0)
    upper = np.log(np.array(done[len(done) // 2 - (len(done) > 1) :]))
    return float(np.polyfit(*upper.T, 1)[0]) if len(upper) > 1 else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", help="names, each with sizes after it if not all")
    parser.add_argument("--commands", nargs="+", choices=COMMANDS, default=list(COMMANDS))
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    chosen: dict[str, list[int]] = {}
    for word in arguments.families or FAMILIES:
        if word.isdigit():
            chosen[list(chosen)[-1]].append(int(word))
        else:
            chosen[word] = []
    runs: list[Run] = []
    for family, sizes in chosen.items():
        for one in study(family, sizes or list(FAMILIES[family][1]), arguments.commands):
            runs.append(one)
            text = f"{one.family:>10} {one.size:3d} {one.command:<17} {one.seconds:7.1f} s {one.bytes / 1e9:5.2f} GB"
            print(f"{text}  {one.verdict:<9} {one.said[:110]}", flush=True)
    print("\nfamily      command            exponent  worst")
    for family in chosen:
        for command in arguments.commands:
            own = [r for r in runs if (r.family, r.command) == (family, command)]
            bad = [f"{r.size}: {r.verdict}" for r in own if r.verdict not in ("ok", "refused")]
            print(f"{family:<11} {command:<17} {exponent(own):9.1f}  {', '.join(bad) or '-'}")
    if arguments.out:
        text = io.StringIO()
        writer = csv.writer(text)
        writer.writerow(["family", "size", "command", "seconds", "bytes", "status", "verdict", "said"])
        writer.writerows([r.family, r.size, r.command, r.seconds, r.bytes, r.status, r.verdict, r.said] for r in runs)
        arguments.out.write_text(text.getvalue(), encoding="utf-8")


if __name__ == "__main__":
    start = time.monotonic()
    main()
    print(f"{time.monotonic() - start:.0f} s")
