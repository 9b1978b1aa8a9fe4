// Joint, tool and constraint Jacobians of a robot at many configurations, by Pinocchio in C++: the yardstick of
// the benchmarks. Reads a model saved by Pinocchio, closures as lines "joint1 placement1 joint2 placement2 size" and
// configurations; prints nanoseconds a configuration, the least of several runs.
#include <pinocchio/fwd.hpp>

#include <chrono>
#include <fstream>
#include <iostream>
#include <vector>

#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/jacobian.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/serialization.hpp>

struct Closure {
  pinocchio::JointIndex joint1, joint2;
  pinocchio::SE3 placement1, placement2;
  int size;
};

static pinocchio::SE3 read_placement(std::istream& in) {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) in >> rotation(row, column);
    in >> translation(row);
  }
  return {rotation, translation};
}

int main(int, char** arguments) {
  pinocchio::Model model;
  model.loadFromText(arguments[1]);
  pinocchio::Data data(model);
  std::ifstream in(arguments[2]);
  std::size_t closure_count, frame, count;
  in >> frame >> closure_count;
  std::vector<Closure> closures(closure_count);
  int rows = 0;
  for (auto& closure : closures) {
    in >> closure.joint1 >> closure.joint2 >> closure.size;
    closure.placement1 = read_placement(in);
    closure.placement2 = read_placement(in);
    rows += closure.size;
  }
  in >> count;
  std::vector<Eigen::VectorXd> configurations(count, Eigen::VectorXd(model.nq));
  for (auto& q : configurations)
    for (int k = 0; k < model.nq; ++k) in >> q[k];

  Eigen::MatrixXd constraint(rows, model.nv);
  pinocchio::Data::Matrix6x tool(6, model.nv), first(6, model.nv), second(6, model.nv);
  double checksum = 0.0, least = 1e300;
  for (int run = 0; run < 15; ++run) {
    const auto start = std::chrono::steady_clock::now();
    for (const auto& q : configurations) {
      pinocchio::computeJointJacobians(model, data, q);
      tool.setZero();
      pinocchio::updateFramePlacement(model, data, frame);
      pinocchio::getFrameJacobian(model, data, frame, pinocchio::LOCAL_WORLD_ALIGNED, tool);
      int row = 0;
      for (const auto& closure : closures) {
        first.setZero();
        second.setZero();
        pinocchio::getFrameJacobian(model, data, closure.joint1, closure.placement1, pinocchio::LOCAL, first);
        pinocchio::getFrameJacobian(model, data, closure.joint2, closure.placement2, pinocchio::LOCAL, second);
        const auto relative = (data.oMi[closure.joint1] * closure.placement1)
                                  .actInv(data.oMi[closure.joint2] * closure.placement2);
        constraint.middleRows(row, closure.size).noalias() =
            (relative.toActionMatrix() * second - first).topRows(closure.size);
        row += closure.size;
      }
      checksum += tool(0, 0) + constraint(0, 0);
    }
    const std::chrono::duration<double, std::nano> taken = std::chrono::steady_clock::now() - start;
    least = std::min(least, taken.count() / static_cast<double>(count));
  }
  std::cout << least << " " << checksum << "\n";
}
