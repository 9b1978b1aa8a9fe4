"""Exports for grblHAL and ros2_control, compiled against the parts of their interfaces that they use, and run."""

from __future__ import annotations

import csv
import shutil
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.controllers import ControllerName, export_controller

pytestmark = pytest.mark.skipif(shutil.which("g++") is None, reason="no compiler")

GRBL = {
    "grbl.h": """
#pragma once
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#define N_AXIS 6
#define KINEMATICS_API
#define On 1
#define ASCII_EOL "\\n"
#define bit(n) (1UL << (n))
#define bit_istrue(x, mask) (((x) & (mask)) != 0)
typedef union { float values[N_AXIS]; } coord_data_t;
typedef union { int32_t values[N_AXIS]; } mpos_t;
typedef struct { uint32_t mask; } axes_signals_t;
typedef int homing_mode_t;
typedef int sys_state_t;
typedef enum { Alarm_SoftLimit = 2, Alarm_SelftestFailed = 16 } alarm_code_t;
""",
    "hal.h": """
typedef void (*on_jog_cancel_ptr)(sys_state_t state);
typedef void (*on_homing_completed_ptr)(axes_signals_t cycle, bool success);
typedef void (*on_report_options_ptr)(bool newopt);
struct { on_jog_cancel_ptr on_jog_cancel; on_homing_completed_ptr on_homing_completed;
         on_report_options_ptr on_report_options; } grbl;
struct { struct { void (*write)(const char *text); } stream; } hal;
""",
    "settings.h": "struct { struct { float steps_per_mm; } axis[N_AXIS]; } settings;\n",
    "planner.h": """
typedef struct { float feed_rate, rate_multiplier;
                 struct { int target_validated, target_valid, rapid_motion, inverse_time; } condition;
} plan_line_data_t;
""",
    "system.h": """
struct { int32_t position[N_AXIS]; float home_position[N_AXIS]; } sys;
int alarm_raised;
#define system_set_exec_alarm(code) (alarm_raised = (code))
static void system_raise_alarm(alarm_code_t code) { alarm_raised = code; }
""",
    "kinematics/interface.h": """
struct {
  coord_data_t *(*transform_steps_to_cartesian)(coord_data_t *position, mpos_t *steps);
  coord_data_t *(*transform_from_cartesian)(coord_data_t *target, coord_data_t *position);
  coord_data_t *(*segment_line)(coord_data_t *target, coord_data_t *position, plan_line_data_t *pl_data, bool init);
  uint_fast8_t (*limits_get_axis_mask)(uint_fast8_t idx);
  void (*limits_set_target_pos)(uint_fast8_t idx);
  void (*limits_set_machine_positions)(axes_signals_t cycle);
  bool (*homing_cycle_validate)(axes_signals_t cycle);
  float (*homing_cycle_get_feedrate)(axes_signals_t axes, float rate, homing_mode_t mode);
} kinematics;
""",
}
GRBL_MAIN = """
#include <stdio.h>
#include "NAME_grblhal.c"
static void print(const float *values)
{
  int k;
  for (k = 0; k < N_AXIS; k++)
    printf("%.9g ", values[k]);
}
/* Read targets X Y Z A B C, and print the motors of each piece of the moves to them with the feed. */
int main(void)
{
  coord_data_t motors, target, back;
  mpos_t steps;
  int k;
  for (k = 0; k < N_AXIS; k++)
    settings.axis[k].steps_per_mm = 100000.0f;
  my_plugin_init();
  kinematics.limits_set_machine_positions((axes_signals_t){ .mask = 63 });
  for (k = 0; k < N_AXIS; k++)
    motors.values[k] = sys.position[k] / settings.axis[k].steps_per_mm;
  while (scanf("%f %f %f %f %f %f", target.values, target.values + 1, target.values + 2, target.values + 3,
               target.values + 4, target.values + 5) == 6) {
    plan_line_data_t plan = {0};
    coord_data_t *at;
    alarm_raised = 0;
    plan.feed_rate = 600.0f;
    at = kinematics.segment_line(&target, &motors, &plan, true);
    printf("move %d\\n", alarm_raised);
    while (kinematics.segment_line(at, NULL, &plan, false)) {
      print(at->values);
      printf("%.9g\\n", plan.feed_rate);
      plan.feed_rate = 600.0f;
      motors = *at;
    }
    for (k = 0; k < N_AXIS; k++)
      steps.values[k] = (int32_t)lroundf(motors.values[k] * settings.axis[k].steps_per_mm);
    kinematics.transform_steps_to_cartesian(&back, &steps);
    printf("end ");
    print(back.values);
    printf("\\n");
  }
  return 0;
}
"""


def built(folder: Path, name: str) -> Path:
    export_controller(pm.load(name), "grblhal", folder)
    for path, text in GRBL.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_text(text)
    (folder / "main.c").write_text(GRBL_MAIN.replace("NAME", name))
    flags = ["-std=gnu99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-O1", "-I."]
    subprocess.run(["gcc", *flags, "main.c", "-o", "machine", "-lm"], cwd=folder, check=True)
    return folder / "machine"


def moves(machine: Path, targets: np.ndarray) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return for each target the alarm, motors and feed of the pieces, and where the motors' steps are."""
    text = "\n".join(" ".join(map(repr, row)) for row in targets.tolist())
    lines = subprocess.run([machine], input=text, capture_output=True, text=True, check=True).stdout.splitlines()
    found, pieces, alarm = [], [], 0
    for line in lines:
        word, *numbers = line.split()
        if word == "move":
            pieces, alarm = [], int(numbers[0])
        elif word == "end":
            found.append((alarm, np.array(pieces), np.array(numbers, dtype=float)))
        else:
            pieces.append([float(word), *map(float, numbers)])
    return found


@pytest.mark.parametrize("name", ["hexapod", "pm3dof", "linear_delta"])
def test_moves_of_grblhal_are_divided_and_end_where_pinocchio_says(name: str, tmp_path: Path) -> None:
    robot, machine = pm.load(name), built(tmp_path, name)
    with (tmp_path / "check_motors.csv").open(newline="") as file:
        header, *rows = csv.reader(file)
    numbers = np.array(rows, dtype=float)
    letters = [word.removeprefix("stop ") for word in header if word.startswith("stop ")]
    columns, count = ["XYZABC".index(letter) for letter in letters], len(robot.commands)
    home = np.zeros(6)
    targets = np.tile(home, (len(numbers), 1))
    targets[:, columns] = numbers[:, : len(letters)]
    shown = np.array([1e3 if c.unit == "m" else np.degrees(1.0) for c in robot.coordinates])
    start = robot.home_coordinates * shown
    for wanted, target, (alarm, pieces, end) in zip(numbers, targets, moves(machine, targets), strict=True):
        assert alarm == 0
        np.testing.assert_allclose(pieces[-1, :count], wanted[len(letters) :], rtol=3e-7, atol=3e-5)  # float
        np.testing.assert_allclose(end[columns], target[columns], atol=1e-3)
        # drives that move evenly over a piece are off by at most 5 um, and the feed is that of the tool's axes
        share = np.arange(len(pieces) + 1)[:, None] / len(pieces)
        places = start + share * (target[columns] - start)
        commands = robot.solve(np.concatenate([places, 0.5 * (places[1:] + places[:-1])]) / shown).commands
        ends, middles = np.split(commands, [len(places)])
        assert np.abs(0.5 * (ends[1:] + ends[:-1]) - middles).max() < 6e-6
        ratio = np.linalg.norm(np.diff(ends, axis=0), axis=1) * 1e3 / np.linalg.norm(np.diff(places, axis=0), axis=1)
        np.testing.assert_allclose(pieces[:, -1], 600.0 * ratio, rtol=2e-2)
        start = target[columns]


def test_move_of_grblhal_whose_middle_is_not_legal_does_not_begin(tmp_path: Path) -> None:
    machine = built(tmp_path, "pm3dof")
    ends = np.array([[0.5814, 0.1179, 0.5327], [0.2705, -0.3911, 0.5563]])
    targets = np.zeros((3, 6))
    targets[:2, 3:5], targets[:2, 2] = np.degrees(ends[:, :2]), 1e3 * ends[:, 2]
    targets[2] = 0.0, 0.0, 1500.0, 0.0, 0.0, 0.0
    first, second, third = moves(machine, targets)
    assert first[0] == 0
    for alarm, pieces, _ in (second, third):
        assert alarm == 2
        assert len(pieces) == 0


ROS = {
    "rclcpp/logging.hpp": """
#include <cstdio>
namespace rclcpp { struct Logger {}; inline Logger get_logger(const char *) { return {}; } }
#define RCLCPP_ERROR(logger, ...) ((void)(logger), std::fprintf(stderr, __VA_ARGS__))
""",
    "pluginlib/class_list_macros.hpp": """
#define PLUGINLIB_EXPORT_CLASS(a, b) static_assert(std::is_base_of<b, a>::value);
""",
    "kinematics_interface/kinematics_interface.hpp": """
#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <memory>
#include <string>
namespace rclcpp::node_interfaces { class NodeParametersInterface {}; }
namespace kinematics_interface
{
using V = Eigen::VectorXd;
using T = Eigen::Matrix<double, 6, 1>;
using P = Eigen::Matrix<double, 7, 1>;
struct KinematicsInterface
{
  virtual ~KinematicsInterface() = default;
  virtual bool initialize(const std::string &, std::shared_ptr<rclcpp::node_interfaces::NodeParametersInterface>,
                          const std::string &) = 0;
  virtual bool convert_cartesian_deltas_to_joint_deltas(const V &, const T &, const std::string &, V &) = 0;
  virtual bool convert_joint_deltas_to_cartesian_deltas(const V &, const V &, const std::string &, T &) = 0;
  virtual bool calculate_link_transform(const V &, const std::string &, Eigen::Isometry3d &) = 0;
  virtual bool calculate_jacobian(const V &, const std::string &, Eigen::Matrix<double, 6, Eigen::Dynamic> &) = 0;
  virtual bool calculate_jacobian_inverse(const V &, const std::string &,
                                          Eigen::Matrix<double, Eigen::Dynamic, 6> &) = 0;
  virtual bool calculate_frame_difference(P &, P &, double, T &) = 0;
};
}
""",
    "hardware_interface/hardware_info.hpp": """
#include <string>
#include <vector>
namespace hardware_interface
{
constexpr char HW_IF_POSITION[] = "position", HW_IF_VELOCITY[] = "velocity", HW_IF_EFFORT[] = "effort";
struct JointInfo { std::string name; };
struct ActuatorInfo { std::string name; };
struct TransmissionInfo { std::vector<JointInfo> joints; std::vector<ActuatorInfo> actuators; };
}
""",
    "transmission_interface/accessor.hpp": """
#include <string>
#include <vector>
namespace transmission_interface
{
struct Handle
{
  std::string name, kind;
  double * value;
  double get_value() const { return *value; }
  void set_value(double v) { *value = v; }
};
struct JointHandle : Handle {};
struct ActuatorHandle : Handle {};
template <class H>
std::vector<H> get_ordered_handles(const std::vector<H> & all, const std::vector<std::string> & names,
                                   const std::string & kind)
{
  std::vector<H> found;
  for (const auto & name : names)
    for (const auto & each : all)
      if (each.name == name && each.kind == kind) found.push_back(each);
  return found;
}
}
""",
    "transmission_interface/exception.hpp": """
#include <stdexcept>
namespace transmission_interface { struct Exception : std::runtime_error { using std::runtime_error::runtime_error; }; }
""",
    "transmission_interface/transmission.hpp": """
namespace transmission_interface
{
struct Transmission
{
  virtual ~Transmission() = default;
  virtual void configure(const std::vector<JointHandle> &, const std::vector<ActuatorHandle> &) = 0;
  virtual void actuator_to_joint() = 0;
  virtual void joint_to_actuator() = 0;
  virtual std::size_t num_actuators() const = 0;
  virtual std::size_t num_joints() const = 0;
};
}
""",
    "transmission_interface/transmission_loader.hpp": """
namespace transmission_interface
{
struct TransmissionLoader
{
  virtual ~TransmissionLoader() = default;
  virtual std::shared_ptr<Transmission> load(const hardware_interface::TransmissionInfo &) = 0;
};
}
""",
}
ROS_MAIN = """
#include <iostream>
#include "src/kinematics.cpp"
#include "src/transmission.cpp"
using namespace NAME_kinematics;
namespace ti = transmission_interface;
int main()
{
  const int n = UPPER_COMMANDS, m = UPPER_COORDINATES;
  std::cout.precision(17);
  CLASSKinematics plugin;
  if (!plugin.initialize("", nullptr, "")) return 1;
  Eigen::VectorXd u(n), du;
  for (int k = 0; k < n; ++k) std::cin >> u(k);
  Eigen::Isometry3d tool;
  Eigen::Matrix<double, 6, Eigen::Dynamic> jacobian;
  Eigen::Matrix<double, Eigen::Dynamic, 6> inverse;
  Eigen::Matrix<double, 6, 1> dx;
  if (!plugin.calculate_link_transform(u, "TOOL", tool) || !plugin.calculate_jacobian(u, "TOOL", jacobian) ||
      !plugin.calculate_jacobian_inverse(u, "TOOL", inverse) || plugin.calculate_jacobian(u, "other", jacobian))
    return 2;
  Eigen::VectorXd step = Eigen::VectorXd::LinSpaced(n, 0.1, 0.2);
  if (!plugin.convert_joint_deltas_to_cartesian_deltas(u, step, "TOOL", dx) ||
      !plugin.convert_cartesian_deltas_to_joint_deltas(u, dx, "TOOL", du))
    return 3;
  std::cout << tool.matrix() << "\\n" << jacobian << "\\n" << inverse.transpose() << "\\n";
  std::cout << (du - step).norm() << "\\n";
  hardware_interface::TransmissionInfo info;
  std::vector<std::vector<double>> a(3, std::vector<double>(n)), j(3, std::vector<double>(m));
  std::vector<ti::ActuatorHandle> actuators;
  std::vector<ti::JointHandle> joints;
  const char * kinds[3] = {"position", "velocity", "effort"};
  for (int k = 0; k < n; ++k) {
    info.actuators.push_back({"a" + std::to_string(k)});
    for (int i = 0; i < 3; ++i) actuators.push_back({{info.actuators[k].name, kinds[i], &a[i][k]}});
    a[0][k] = u(k); a[1][k] = step(k); a[2][k] = 10.0 + k;
  }
  for (int k = 0; k < m; ++k) {
    info.joints.push_back({"j" + std::to_string(k)});
    for (int i = 0; i < 3; ++i) joints.push_back({{info.joints[k].name, kinds[i], &j[i][k]}});
  }
  auto transmission = CLASSTransmissionLoader().load(info);
  transmission->configure(joints, actuators);
  transmission->actuator_to_joint();
  for (int i = 0; i < 3; ++i) { for (double v : j[i]) std::cout << v << " "; std::cout << "\\n"; }
  for (auto & part : a) for (double & v : part) v = 0.0;
  transmission->joint_to_actuator();
  for (int i = 0; i < 3; ++i) { for (double v : a[i]) std::cout << v << " "; std::cout << "\\n"; }
}
"""


def _eigen() -> Path | None:
    packages = Path(sysconfig.get_path("purelib"))
    places = (Path("/usr/include/eigen3"), packages / "casadi" / "include" / "eigen3")
    return next((place for place in places if (place / "Eigen" / "QR").exists()), None)


@pytest.mark.skipif(_eigen() is None, reason="no Eigen")
def test_plugins_of_ros2_control(tmp_path: Path) -> None:
    name = "ankle_rus"  # compiling Eigen for one machine takes half a minute
    robot = pm.load(name)
    export_controller(robot, "ros2_control", tmp_path)
    for path, text in ROS.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text("#pragma once\n" + text)
    words = {"UPPER": name.upper(), "CLASS": "".join(p.capitalize() for p in name.split("_")), "NAME": name}
    main = ROS_MAIN.replace("TOOL", str(robot.tool_frame))
    for word, value in words.items():
        main = main.replace(word, value)
    (tmp_path / "main.cpp").write_text(main)
    subprocess.run(
        ["gcc", "-std=c99", "-O0", "-c", "-Iinclude", f"src/{name}.c", "-o", "core.o"], cwd=tmp_path, check=True
    )
    flags = ["-std=c++17", "-Wall", "-Wextra", "-O0", "-I.", "-Iinclude", "-isystem", str(_eigen())]
    subprocess.run(["g++", *flags, "main.cpp", "core.o", "-o", "main"], cwd=tmp_path, check=True)
    home, n, m = robot.home_coordinates, len(robot.commands), len(robot.coordinates)
    scale = np.array([robot.characteristic_length if c.unit == "m" else 1.0 for c in robot.coordinates])
    poses = robot.solve(home + 0.05 * scale * np.linspace(-1.0, 1.0, m))
    text = " ".join(map(repr, poses.commands.tolist()))
    lines = subprocess.run([tmp_path / "main"], input=text, capture_output=True, text=True, check=True).stdout
    rows = [np.array(line.split(), dtype=float) for line in lines.splitlines()]
    np.testing.assert_allclose(rows[:4], poses.transforms, atol=1e-10)
    of_drives = pm.jacobian(robot, poses, of="tool", by="commands").values
    np.testing.assert_allclose(rows[4:10], of_drives, atol=1e-7)
    np.testing.assert_allclose(np.array(rows[10:16]).T, np.linalg.pinv(of_drives), atol=1e-5)
    assert rows[16][0] < 1e-9
    J = pm.jacobian(robot, poses, of="commands", by="coordinates").values
    speeds, efforts = np.linspace(0.1, 0.2, n), 10.0 + np.arange(n)
    np.testing.assert_allclose(rows[17], poses.coordinates, atol=1e-10)
    np.testing.assert_allclose(rows[18], np.linalg.solve(J, speeds), atol=1e-7)
    np.testing.assert_allclose(rows[19], J.T @ efforts, atol=1e-6)
    for found, wanted in zip(rows[20:], (poses.commands, speeds, efforts), strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-7)


def slides(folder: Path, count: int) -> pm.Robot:
    """Return a stack of driven slides, the first three along the axes and the others oblique."""
    axes = ["1 0 0", "0 1 0", "0 0 1", *["0.6 0.8 0", "0.8 0 0.6", "0 0.6 0.8"] * count][:count]
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = "".join(
        f'<link name="l{k + 1}">{inertial}</link><joint name="j{k}" type="prismatic"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><axis xyz="{axis}"/><limit lower="-0.1" upper="0.1" effort="1" velocity="1"/></joint>'
        for k, axis in enumerate(axes)
    )
    (folder / "slides.urdf").write_text(f'<robot name="slides"><link name="l0"/>{text}</robot>')
    return pm.load(folder / "slides.urdf", drives=[f"j{k}" for k in range(count)])


def test_grblhal_has_axes_u_and_v(tmp_path: Path) -> None:
    """By nuts_bolts.h X, Y, Z, A, B, C, U, V are 0 to 7, and there is no W."""
    export_controller(slides(tmp_path, 4), "grblhal", tmp_path)
    source = (tmp_path / "slides_grblhal.c").read_text()
    assert "axis_of[PLACES] = {0, 1, 2, 6};" in source
    assert "#if N_AXIS < 7" in source
    with pytest.raises(InvalidValueError, match="9 axes: expected at most 8"):
        export_controller(slides(tmp_path, 6), "grblhal", tmp_path / "six")


@pytest.mark.parametrize(("controller", "most"), [("grblhal", 8), ("linuxcnc", 16)])
def test_too_many_drives_are_refused_before_the_work(
    controller: ControllerName, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pm3dof_pin.export.controllers.Controller", None)  # the work
    robot = slides(tmp_path, most + 1)
    with pytest.raises(InvalidValueError, match=f"has {most + 1} drives: expected at most {most} for {controller}"):
        export_controller(robot, controller, tmp_path / "files")
