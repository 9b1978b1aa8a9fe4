"""Scripts of an exported LinuxCNC configuration: a headless run, and the comparison of its joints."""

from __future__ import annotations

from pm3dof_pin.export.template import fill

_TOLERANCE = 1e-9  # of the joints at the stops [mm, deg]

_CHECK = '''#!/usr/bin/python3
"""Run check.ngc in LinuxCNC and compare the joints at its stops with check_joints.csv: exit status 0 if they agree.

It takes the place of the display: DISPLAY = check.py in the INI file. run_sim.sh does that. With the name of another
program it runs that one and writes the commanded joints to joints.csv: seconds, mm and degrees.
"""

import csv
import sys
import time
from pathlib import Path

import linuxcnc

FOLDER = Path(__file__).resolve().parent
TOLERANCE_OF_JOINTS = @TOLERANCE@  # mm, deg
command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def poll():
    status.poll()
    found = errors.poll()
    if found and found[0] in (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR):
        sys.exit(f"LinuxCNC: {found[1]}")


def wait(condition, what, seconds=60.0):
    end, joints = time.monotonic() + seconds, None
    while time.monotonic() < end:
        poll()
        if condition():
            return
        if status.joint_position != joints:  # slow moves take as long as they need
            end, joints = time.monotonic() + seconds, status.joint_position
        time.sleep(0.002)
    sys.exit(f"no {what} within {seconds:g} s of standstill")


def start(program, count):
    command.state(linuxcnc.STATE_ESTOP_RESET)
    wait(lambda: status.task_state != linuxcnc.STATE_ESTOP, "reset of the emergency stop")
    command.state(linuxcnc.STATE_ON)
    wait(lambda: status.task_state == linuxcnc.STATE_ON, "machine on")
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.home(-1)
    wait(lambda: all(status.homed[:count]), "homing")
    command.teleop_enable(1)
    command.mode(linuxcnc.MODE_AUTO)
    command.wait_complete()
    command.program_open(str(program))
    command.auto(linuxcnc.AUTO_RUN, 0)


def compare(rows, joints):
    worst = 0.0
    for number, row in enumerate(rows, start=1):
        wait(lambda: status.interp_state == linuxcnc.INTERP_PAUSED and status.inpos, f"stop {number}")
        off = max(abs(status.joint_position[k] - float(row[place])) for k, place in enumerate(joints))
        worst = max(worst, off)
        print(f"stop {number:2d}: joints off by at most {off:.2e}", flush=True)
        command.auto(linuxcnc.AUTO_RESUME)
        wait(lambda: status.interp_state != linuxcnc.INTERP_PAUSED, "resumption")
    print(f"worst {worst:.3e} mm or deg at {len(rows)} stops", flush=True)
    return 0 if worst <= TOLERANCE_OF_JOINTS else f"joints are off by {worst:.3e} mm or deg"


def record(count):
    rows, begun = [], time.monotonic()
    wait(lambda: status.interp_state != linuxcnc.INTERP_IDLE, "start of the program")
    while status.interp_state != linuxcnc.INTERP_IDLE or not status.inpos:
        joints = status.joint_position[:count]
        if not rows or joints != rows[-1][1]:
            rows.append((time.monotonic() - begun, joints))
        time.sleep(0.001)
        poll()
    rows.append((time.monotonic() - begun, status.joint_position[:count]))
    with open(FOLDER / "joints.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time_s", *(f"joint_{k}" for k in range(count))])
        writer.writerows([f"{seconds:.4f}", *map(repr, joints)] for seconds, joints in rows)
    print(f"joints at {len(rows)} times, from the first move to the last {rows[-1][0] - rows[0][0]:.2f} s", flush=True)
    return 0


def main():
    with open(FOLDER / "check_joints.csv", newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    joints = [k for k, name in enumerate(header) if name.startswith("joint_")]
    others = [word for word in sys.argv[1:] if word.endswith(".ngc")]
    start(FOLDER / (others[0] if others else "check.ngc"), len(joints))
    return record(len(joints)) if others else compare(rows, joints)


if __name__ == "__main__":
    sys.exit(main())
'''

_RUN = """#!/bin/sh
# Build the module and run check.ngc in LinuxCNC, without display, root or installation: the module is laid over
# LinuxCNC's folder of modules for this run only, in a user and mount namespace. Exit status 0 if all joints agree.
# run_sim.sh PROGRAM runs a program instead and writes its joints to joints.csv.
set -e
here=$(cd "$(dirname "$0")" && pwd)
program=
if [ -n "$1" ]; then cp "$1" "$here/program.ngc"; program=" program.ngc"; fi
cd "$here"
halcompile --compile @MODULE@.c >build.log 2>&1 || { cat build.log >&2; exit 1; }
sed "s/^DISPLAY = .*/DISPLAY = .\\/check.py$program/" @NAME@.ini >sim.ini
modules=${LINUXCNC_MODULES:-/usr/lib/linuxcnc/modules}
mkdir -p build home
chmod +x check.py
mv -f @MODULE@.so build/
export HOME="$PWD/home" modules
unshare -r -m -i -n -p --fork --kill-child --mount-proc sh -e -c '
  mount -t overlay overlay -o "lowerdir=$PWD/build:$modules" "$modules"
  ip link set lo up 2>/dev/null || true
  exec unshare -U --map-user=1000 linuxcnc -r "$PWD/sim.ini" </dev/null
'
"""


def check_script() -> str:
    """Return the script that runs a program in LinuxCNC in place of a display."""
    return fill(_CHECK, {"TOLERANCE": repr(_TOLERANCE)})


def run_script(name: str, module: str) -> str:
    """Return the shell script that builds a configuration's module and runs it headless."""
    return fill(_RUN, {"MODULE": module, "NAME": name})
