"""A ROS 2 package for ros2_control: kinematics of a closed chain as a plugin, and its transmission."""

from __future__ import annotations

from collections.abc import Callable

from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.export.ros import manifest
from pm3dof_pin.export.template import c_comment, fill, markdown, xml


def ros2_control_files(controller: Controller) -> dict[str, str]:
    """Return the files of a package: texts by path. Plugins that need a tool frame are left out without one."""
    robot, name = controller.robot, controller.name
    package, has_tool = f"{name}_kinematics", robot.tool_frame is not None
    texts = {
        "PACKAGE": package,
        "NAME": name,
        "UPPER": name.upper(),
        "CLASS": "".join(part.capitalize() for part in name.split("_")),
        "MODEL": "calibrated" if "calibrated" in controller.models else "nominal",
        "SOURCES": "src/transmission.cpp" + (" src/kinematics.cpp" if has_tool else ""),
    }
    names = {
        "ROBOT": robot.name,
        "TOOL": robot.tool_frame or "",
        "COMMANDS": ", ".join(f"{c.name} [{c.unit}]" for c in robot.command_coordinates),
        "COORDINATES": ", ".join(f"{c.name} [{c.unit}]" for c in robot.coordinates),
    }

    def filled(template: str, escaped: Callable[[str], str] = c_comment) -> str:
        return fill(template, texts, names, escaped)

    core = c_files(controller)
    files = {f"{'include/' + package if path.endswith('.h') else 'src'}/{path}": text for path, text in core.items()}
    files[f"src/{name}.c"] = files[f"src/{name}.c"].replace(f'#include "{name}', f'#include "{package}/{name}')
    files |= {"src/transmission.cpp": filled(_TRANSMISSION), "transmission_plugins.xml": filled(_TRANSMISSION_XML, xml)}
    if has_tool:
        files |= {"src/kinematics.cpp": filled(_KINEMATICS), "kinematics_plugins.xml": filled(_KINEMATICS_XML, xml)}
    cmake, depends = _CMAKE, [*_DEPENDS]
    if not has_tool:
        cmake = "".join(line for line in cmake.splitlines(keepends=True) if "kinematics_interface" not in line)
        depends.remove("kinematics_interface")
    files["CMakeLists.txt"] = filled(cmake)
    files["package.xml"] = manifest(
        package,
        f"Kinematics and transmission of {robot.name}",
        "ros2_control",
        [f"<depend>{name}</depend>" for name in depends],
        license_name="BSD-2-Clause",
    )
    return {**files, "README.md": filled(_README, markdown)}


_KINEMATICS = """\
// Kinematics of @ROBOT@ for ros2_control. Written by pm3dof export ros2_control.
//
// Joints are the drives, in this order: @COMMANDS@. The only link is the tool, @TOOL@, in the base of the robot.
#include <Eigen/QR>
#include <cmath>
#include <memory>
#include <string>

#include "kinematics_interface/kinematics_interface.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "@PACKAGE@/@NAME@.h"
#include "rclcpp/logging.hpp"

namespace @PACKAGE@
{
class @CLASS@Kinematics : public kinematics_interface::KinematicsInterface
{
public:
  using Twist = Eigen::Matrix<double, 6, 1>;

  bool initialize(
    const std::string & /*robot_description*/,
    std::shared_ptr<rclcpp::node_interfaces::NodeParametersInterface> /*parameters_interface*/,
    const std::string & /*param_namespace*/) override
  {
    double worst = 0.0;
    if (@NAME@_selftest(&@NAME@_@MODEL@, &worst) != 0)
    {
      RCLCPP_ERROR(logger_, "the self-test of %s fails: off by %g", @"ROBOT"@, worst);
      return false;
    }
    @NAME@_start(&@NAME@_@MODEL@, &state_);
    is_ready_ = true;
    return true;
  }

  bool convert_cartesian_deltas_to_joint_deltas(
    const Eigen::VectorXd & joint_pos, const Twist & delta_x, const std::string & link_name,
    Eigen::VectorXd & delta_theta) override
  {
    if (!place(joint_pos, link_name))
    {
      return false;
    }
    delta_theta = rates_ * motion_.completeOrthogonalDecomposition().solve(delta_x);
    return true;
  }

  bool convert_joint_deltas_to_cartesian_deltas(
    const Eigen::VectorXd & joint_pos, const Eigen::VectorXd & delta_theta, const std::string & link_name,
    Twist & delta_x) override
  {
    if (delta_theta.size() != @UPPER@_COMMANDS || !place(joint_pos, link_name))
    {
      return false;
    }
    delta_x = motion_ * rates_.completeOrthogonalDecomposition().solve(delta_theta);
    return true;
  }

  bool calculate_link_transform(
    const Eigen::VectorXd & joint_pos, const std::string & link_name, Eigen::Isometry3d & transform) override
  {
    if (!forward(joint_pos, link_name))
    {
      return false;
    }
    transform = tool(state_);
    return true;
  }

  bool calculate_jacobian(
    const Eigen::VectorXd & joint_pos, const std::string & link_name,
    Eigen::Matrix<double, 6, Eigen::Dynamic> & jacobian) override
  {
    if (!place(joint_pos, link_name))
    {
      return false;
    }
    jacobian = motion_ * rates_.completeOrthogonalDecomposition().pseudoInverse();
    return true;
  }

  bool calculate_jacobian_inverse(
    const Eigen::VectorXd & joint_pos, const std::string & link_name,
    Eigen::Matrix<double, Eigen::Dynamic, 6> & jacobian_inverse) override
  {
    if (!place(joint_pos, link_name))
    {
      return false;
    }
    jacobian_inverse = rates_ * motion_.completeOrthogonalDecomposition().pseudoInverse();
    return true;
  }

  bool calculate_frame_difference(
    Eigen::Matrix<double, 7, 1> & x_a, Eigen::Matrix<double, 7, 1> & x_b, double dt, Twist & delta_x) override
  {
    if (!(dt > 0.0))
    {
      return false;
    }
    const Eigen::Quaterniond a(x_a(6), x_a(3), x_a(4), x_a(5)), b(x_b(6), x_b(3), x_b(4), x_b(5));
    const Eigen::AngleAxisd turn(b.normalized() * a.normalized().conjugate());
    delta_x.head<3>() = (x_b.head<3>() - x_a.head<3>()) / dt;
    delta_x.tail<3>() = turn.angle() * turn.axis() / dt;
    return true;
  }

private:
  static Eigen::Isometry3d tool(const @NAME@_state & state)
  {
    double rows[4][4];
    @NAME@_tool(&@NAME@_@MODEL@, &state, rows);
    Eigen::Isometry3d placement;
    for (int i = 0; i < 4; ++i)
    {
      for (int j = 0; j < 4; ++j)
      {
        placement.matrix()(i, j) = rows[i][j];
      }
    }
    return placement;
  }

  bool forward(const Eigen::VectorXd & joint_pos, const std::string & link_name)
  {
    if (!is_ready_ || link_name != @"TOOL"@ || joint_pos.size() != @UPPER@_COMMANDS)
    {
      RCLCPP_ERROR(logger_, "expected link %s and %d joints, after initialize", @"TOOL"@, @UPPER@_COMMANDS);
      return false;
    }
    return @NAME@_forward(&@NAME@_@MODEL@, &state_, joint_pos.data(), coordinates_) == @UPPER@_OK;
  }

  // The pose at joints, and the motions there: rates of the drives, and twists of the tool, by the coordinates. The
  // twists are central differences, right to about 1e-9.
  bool place(const Eigen::VectorXd & joint_pos, const std::string & link_name)
  {
    double jac[@UPPER@_COMMANDS][@UPPER@_COORDINATES];
    if (!forward(joint_pos, link_name) || @NAME@_jacobian(&@NAME@_@MODEL@, &state_, jac) != @UPPER@_OK)
    {
      return false;
    }
    const double step = 1e-5;
    for (int k = 0; k < @UPPER@_COORDINATES; ++k)
    {
      Eigen::Isometry3d ends[2];
      for (int side = 0; side < 2; ++side)
      {
        @NAME@_state near = state_;
        double x[@UPPER@_COORDINATES], commands[@UPPER@_COMMANDS];
        for (int i = 0; i < @UPPER@_COORDINATES; ++i)
        {
          x[i] = coordinates_[i] + (i == k ? (side ? step : -step) : 0.0);
        }
        if (@NAME@_inverse(&@NAME@_@MODEL@, &near, x, commands) != @UPPER@_OK)
        {
          return false;
        }
        ends[side] = tool(near);
      }
      const Eigen::Matrix3d turn = ends[1].rotation() * ends[0].rotation().transpose();
      motion_.block<3, 1>(0, k) = (ends[1].translation() - ends[0].translation()) / (2.0 * step);
      motion_.block<3, 1>(3, k) =
        Eigen::Vector3d(turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1)) / (4.0 * step);
      for (int j = 0; j < @UPPER@_COMMANDS; ++j)
      {
        rates_(j, k) = jac[j][k];
      }
    }
    return true;
  }

  rclcpp::Logger logger_ = rclcpp::get_logger("@PACKAGE@");
  bool is_ready_ = false;
  @NAME@_state state_{};
  double coordinates_[@UPPER@_COORDINATES] = {};
  Eigen::Matrix<double, 6, @UPPER@_COORDINATES> motion_;
  Eigen::Matrix<double, @UPPER@_COMMANDS, @UPPER@_COORDINATES> rates_;
};
}  // namespace @PACKAGE@

PLUGINLIB_EXPORT_CLASS(@PACKAGE@::@CLASS@Kinematics, kinematics_interface::KinematicsInterface)
"""

_TRANSMISSION = """\
// Transmission of @ROBOT@ through its closed loops, for ros2_control. Written by pm3dof export ros2_control.
//
// Actuators are the drives: @COMMANDS@; joints are the coordinates: @COORDINATES@. In the <transmission> of the URDF
// they are listed in these orders. Values are written only where the loops close.
#include <Eigen/Core>
#include <Eigen/QR>
#include <memory>
#include <string>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "@PACKAGE@/@NAME@.h"
#include "transmission_interface/accessor.hpp"
#include "transmission_interface/exception.hpp"
#include "transmission_interface/transmission.hpp"
#include "transmission_interface/transmission_loader.hpp"

namespace @PACKAGE@
{
namespace hi = hardware_interface;
namespace ti = transmission_interface;

class @CLASS@Transmission : public ti::Transmission
{
public:
  @CLASS@Transmission(std::vector<std::string> joints, std::vector<std::string> actuators)
  : joint_names_(std::move(joints)), actuator_names_(std::move(actuators))
  {
    double worst = 0.0;
    if (joint_names_.size() != num_joints() || actuator_names_.size() != num_actuators())
    {
      throw ti::Exception(@"ROBOT"@ " has other numbers of joints and actuators");
    }
    if (@NAME@_selftest(&@NAME@_@MODEL@, &worst) != 0)
    {
      throw ti::Exception("the self-test fails of " @"ROBOT"@);
    }
    @NAME@_start(&@NAME@_@MODEL@, &measured_);
    @NAME@_start(&@NAME@_@MODEL@, &commanded_);
  }

  void configure(
    const std::vector<ti::JointHandle> & joints, const std::vector<ti::ActuatorHandle> & actuators) override
  {
    const char * const kinds[3] = {hi::HW_IF_POSITION, hi::HW_IF_VELOCITY, hi::HW_IF_EFFORT};
    for (int kind = 0; kind < 3; ++kind)
    {
      joints_[kind] = ti::get_ordered_handles(joints, joint_names_, kinds[kind]);
      actuators_[kind] = ti::get_ordered_handles(actuators, actuator_names_, kinds[kind]);
      has_[kind] = joints_[kind].size() == num_joints() && actuators_[kind].size() == num_actuators();
    }
    if (!has_[0])
    {
      throw ti::Exception(@"ROBOT"@ " needs the positions of all joints and actuators: they place its loops");
    }
  }

  void actuator_to_joint() override
  {
    Drives u = read<Drives>(actuators_[0]);
    Places x;
    if (
      @NAME@_forward(&@NAME@_@MODEL@, &measured_, u.data(), x.data()) != @UPPER@_OK || !rates_at(measured_))
    {
      return;
    }
    write(joints_[0], x);
    if (has_[1])
    {
      u = read<Drives>(actuators_[1]);
      write(joints_[1], Places(rates_.completeOrthogonalDecomposition().solve(u)));
    }
    if (has_[2])
    {
      u = read<Drives>(actuators_[2]);
      write(joints_[2], Places(rates_.transpose() * u));
    }
  }

  void joint_to_actuator() override
  {
    Places x = read<Places>(joints_[0]);
    Drives u;
    if (
      @NAME@_inverse(&@NAME@_@MODEL@, &commanded_, x.data(), u.data()) != @UPPER@_OK || !rates_at(commanded_))
    {
      return;
    }
    write(actuators_[0], u);
    if (has_[1])
    {
      x = read<Places>(joints_[1]);
      write(actuators_[1], Drives(rates_ * x));
    }
    if (has_[2])
    {
      const Eigen::Matrix<double, @UPPER@_COORDINATES, @UPPER@_COMMANDS> turned = rates_.transpose();
      x = read<Places>(joints_[2]);
      write(actuators_[2], Drives(turned.completeOrthogonalDecomposition().solve(x)));
    }
  }

  std::size_t num_actuators() const override { return @UPPER@_COMMANDS; }
  std::size_t num_joints() const override { return @UPPER@_COORDINATES; }

private:
  using Drives = Eigen::Matrix<double, @UPPER@_COMMANDS, 1>;
  using Places = Eigen::Matrix<double, @UPPER@_COORDINATES, 1>;

  template <class Values, class Handle>
  static Values read(const std::vector<Handle> & handles)
  {
    Values values;
    for (std::size_t k = 0; k < handles.size(); ++k)
    {
      values(static_cast<Eigen::Index>(k)) = handles[k].get_value();
    }
    return values;
  }

  template <class Handle, class Values>
  static void write(std::vector<Handle> & handles, const Values & values)
  {
    for (std::size_t k = 0; k < handles.size(); ++k)
    {
      handles[k].set_value(values(static_cast<Eigen::Index>(k)));
    }
  }

  bool rates_at(const @NAME@_state & state)
  {
    double jac[@UPPER@_COMMANDS][@UPPER@_COORDINATES];
    if (@NAME@_jacobian(&@NAME@_@MODEL@, &state, jac) != @UPPER@_OK)
    {
      return false;
    }
    for (int j = 0; j < @UPPER@_COMMANDS; ++j)
    {
      for (int k = 0; k < @UPPER@_COORDINATES; ++k)
      {
        rates_(j, k) = jac[j][k];
      }
    }
    return true;
  }

  std::vector<std::string> joint_names_, actuator_names_;
  std::vector<ti::JointHandle> joints_[3];
  std::vector<ti::ActuatorHandle> actuators_[3];
  bool has_[3] = {false, false, false};
  @NAME@_state measured_{}, commanded_{};
  Eigen::Matrix<double, @UPPER@_COMMANDS, @UPPER@_COORDINATES> rates_;
};

class @CLASS@TransmissionLoader : public ti::TransmissionLoader
{
public:
  std::shared_ptr<ti::Transmission> load(const hi::TransmissionInfo & info) override
  {
    std::vector<std::string> joints, actuators;
    for (const auto & joint : info.joints)
    {
      joints.push_back(joint.name);
    }
    for (const auto & actuator : info.actuators)
    {
      actuators.push_back(actuator.name);
    }
    try
    {
      return std::make_shared<@CLASS@Transmission>(joints, actuators);
    }
    catch (const ti::Exception &)
    {
      return nullptr;
    }
  }
};
}  // namespace @PACKAGE@

PLUGINLIB_EXPORT_CLASS(@PACKAGE@::@CLASS@TransmissionLoader, transmission_interface::TransmissionLoader)
"""

_KINEMATICS_XML = """<library path="@PACKAGE@">
  <class name="@PACKAGE@/@CLASS@Kinematics" type="@PACKAGE@::@CLASS@Kinematics"
         base_class_type="kinematics_interface::KinematicsInterface">
    <description>Kinematics of @ROBOT@, with its loops closed.</description>
  </class>
</library>
"""

_TRANSMISSION_XML = """<library path="@PACKAGE@">
  <class name="@PACKAGE@/@CLASS@Transmission" type="@PACKAGE@::@CLASS@TransmissionLoader"
         base_class_type="transmission_interface::TransmissionLoader">
    <description>From the drives of @ROBOT@ to its coordinates, through its loops.</description>
  </class>
</library>
"""

_CMAKE = """cmake_minimum_required(VERSION 3.16)
project(@PACKAGE@ LANGUAGES C CXX)

find_package(ament_cmake REQUIRED)
find_package(Eigen3 REQUIRED NO_MODULE)
find_package(hardware_interface REQUIRED)
find_package(kinematics_interface REQUIRED)
find_package(pluginlib REQUIRED)
find_package(rclcpp REQUIRED)
find_package(transmission_interface REQUIRED)

add_library(@PACKAGE@ SHARED src/@NAME@.c @SOURCES@)
target_compile_features(@PACKAGE@ PUBLIC cxx_std_17 c_std_99)
target_include_directories(@PACKAGE@ PUBLIC include)
target_link_libraries(@PACKAGE@ PUBLIC Eigen3::Eigen)
ament_target_dependencies(@PACKAGE@ PUBLIC hardware_interface pluginlib rclcpp transmission_interface)
ament_target_dependencies(@PACKAGE@ PUBLIC kinematics_interface)
pluginlib_export_plugin_description_file(kinematics_interface kinematics_plugins.xml)
pluginlib_export_plugin_description_file(transmission_interface transmission_plugins.xml)
install(TARGETS @PACKAGE@ LIBRARY DESTINATION lib)
install(DIRECTORY include/ DESTINATION include)
ament_package()
"""

_DEPENDS = (
    "eigen",
    "hardware_interface",
    "kinematics_interface",
    "pluginlib",
    "rclcpp",
    "transmission_interface",
)

_README = """# @ROBOT@ in ros2_control

Plugins around the C kinematics of `pm3dof export c`; m, rad, N, N m. Compiled against headers of `kinematics_interface`
and `ros2_control` of 2026; not built or run inside ROS 2.

- `@PACKAGE@/@CLASS@Kinematics`, a `kinematics_interface`: joints are the drives (@COMMANDS@), the link is the tool
  (@TOOL@), of robots that have one. Poses follow from the one before, as control loops need.
- `@PACKAGE@/@CLASS@Transmission`, a transmission from actuators, the drives, to joints, the coordinates
  (@COORDINATES@): positions, and where they are connected speeds and efforts, by the Jacobian of the closed chain.
  Hardware interfaces load it by this name in the `<transmission>` of the URDF, joints and actuators in these orders.
- Where the loops do not close, on the way to a singular configuration for example, nothing is written and kinematics
  return false.
"""
