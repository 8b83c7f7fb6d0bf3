// SPDX-License-Identifier: Apache-2.0
// Munthe-Kaas steps around Pinocchio's forward dynamics, in the loop that its user would write.
//
// Joint frames are at the joints, aligned with the world at the start or turned so that z is the
// axis of a hinge or slide. The state is Pinocchio's
// (q, v); an increment psi in the tangent space moves it by pinocchio::integrate, and
//     psi' = dexp^-1_{-psi} v,   v' = aba(q, v),   with loops constraintDynamics(q, v) or lcaba(q, v).
// Only Pinocchio allocates memory within a step.
#include <cmath>
#include <memory>
#include <vector>

#include <pinocchio/algorithm/aba.hpp>
#include <pinocchio/algorithm/constrained-dynamics.hpp>
#include <pinocchio/algorithm/joint-configuration.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/loop-constrained-aba.hpp>

namespace pin = pinocchio;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

enum Kind { FREE = 0, BALL = 1, HINGE = 2, SLIDE = 3, UNIVERSAL = 4, CYLINDRICAL = 5 };

// An axis without round-off next to 0 and 1.
Vector3d snapped(Vector3d axis)
{
  for (int i = 0; i < 3; ++i)
    if (std::abs(axis[i] - std::round(axis[i])) < 1e-14)
      axis[i] = std::round(axis[i]);
  return axis;
}

// A hinge or a slide; Pinocchio has special code for those about and along coordinate axes.
template<class X, class Y, class Z, class Unaligned>
pin::JointModel with_axis(const Vector3d & axis)
{
  if (axis[0] == 1.)
    return X();
  if (axis[1] == 1.)
    return Y();
  if (axis[2] == 1.)
    return Z();
  return Unaligned(axis);
}

pin::JointModel joint_of(int kind, const Vector3d & axis, const Vector3d & second)
{
  if (kind == FREE)
    return pin::JointModelFreeFlyer();
  if (kind == BALL)
    return pin::JointModelSpherical();
  if (kind == UNIVERSAL)
    return pin::JointModelUniversal(axis, second);
  if (kind == SLIDE)
    return with_axis<
      pin::JointModelPX, pin::JointModelPY, pin::JointModelPZ, pin::JointModelPrismaticUnaligned>(
      axis);
  return with_axis<
    pin::JointModelRX, pin::JointModelRY, pin::JointModelRZ, pin::JointModelRevoluteUnaligned>(axis);
}

struct Loop
{
  pin::Model model;
  std::unique_ptr<pin::Data> data;
  std::vector<int> kinds, ids;  // of the bodies, and of the joints that they are on
  std::vector<Matrix3d> turns;  // orientations of the joint frames in the world at the start
  std::vector<pin::RigidConstraintModel> constraints;
  std::vector<pin::RigidConstraintData> constraint_data;
  pin::ProximalSettings settings;
  VectorXd q_start, v_start, q, v, torque, psi, q_stage, v_stage;
  MatrixXd a, k_q, k_v;  // a: tableau, below it its weights; k: one column per stage
  int highest;           // last power of ad in dexp^-1
  bool embedded;         // loops by lcaba

  void evaluate(const VectorXd & q_at, const VectorXd & v_at, int stage)
  {
    if (constraints.empty())
      k_v.col(stage) = pin::aba(model, *data, q_at, v_at, torque);
    else if (embedded)
      k_v.col(stage) =
        pin::lcaba(model, *data, q_at, v_at, torque, constraints, constraint_data, settings);
    else
      k_v.col(stage) = pin::constraintDynamics(
        model, *data, q_at, v_at, torque, constraints, constraint_data, settings);
  }

  // dexp^-1_{-psi} v = v + [psi, v] / 2 + [psi, [psi, v]] / 12 - ..., joint by joint.
  void pull_back(const VectorXd & v_at, int stage)
  {
    static const double bernoulli[] = {1. / 12, -1. / 720, 1. / 30240, -1. / 1209600};
    k_q.col(stage) = v_at;
    for (size_t i = 0; i < kinds.size(); ++i)
    {
      const int at = model.joints[ids[i]].idx_v();
      if (kinds[i] == BALL)
      {
        const Vector3d u = psi.segment<3>(at), w = v_at.segment<3>(at);
        Vector3d bracket = u.cross(w), sum = w + 0.5 * bracket;
        for (int power = 2; power <= highest; power += 2)
        {
          bracket = u.cross(bracket);
          sum += bernoulli[power / 2 - 1] * bracket;
          bracket = u.cross(bracket);
        }
        k_q.col(stage).segment<3>(at) = sum;
      }
      else if (kinds[i] == FREE)
      {
        const pin::Motion u(psi.segment<6>(at)), w(v_at.segment<6>(at));
        pin::Motion bracket = u.cross(w), sum = w + 0.5 * bracket;
        for (int power = 2; power <= highest; power += 2)
        {
          bracket = u.cross(bracket);
          sum += bernoulli[power / 2 - 1] * bracket;
          bracket = u.cross(bracket);
        }
        k_q.col(stage).segment<6>(at) = sum.toVector();
      }
    }
  }

  void step(double h)
  {
    const int stages = int(a.cols());
    k_q.col(0) = v;
    evaluate(q, v, 0);
    for (int stage = 1; stage <= stages; ++stage)
    {
      psi.setZero();
      v_stage = v;
      for (int l = 0; l < stage; ++l)
        if (a(stage, l) != 0.)
        {
          psi += h * a(stage, l) * k_q.col(l);
          v_stage += h * a(stage, l) * k_v.col(l);
        }
      pin::integrate(model, q, psi, q_stage);
      if (stage == stages)
        break;
      pull_back(v_stage, stage);
      evaluate(q_stage, v_stage, stage);
    }
    q.swap(q_stage);
    v.swap(v_stage);
  }
};

extern "C"
{
  // kinds, parents (n); points (n, 3) of the joints from the parent's joint; axes (n, 6) two of each;
  // turns (n, 9) orientations of the joint frames; masses (n); centres (n, 3) from the joint; inertias
  // (n, 9) about the centres; v (nv); loops (m, 2) bodies; anchors (m, 6) points from the joints of the
  // two; all vectors in world axes at the start; a (stages + 1, stages)
  Loop * make(
    int n, const int * kinds, const int * parents, const double * points, const double * axes,
    const double * turns, const double * masses, const double * centres, const double * inertias, const double * gravity,
    const double * v, int m, const int * loops, const double * anchors, int stages, const double * a,
    int highest, double mu, double rate, int embedded, int iterations)
  {
    auto loop = new Loop;
    pin::Model & model = loop->model;
    model.gravity.linear() = Eigen::Map<const Vector3d>(gravity);
    for (int i = 0; i < n; ++i)
    {
      const Matrix3d turn = Eigen::Map<const Matrix3d>(turns + 9 * i).transpose();
      const Matrix3d parent = parents[i] < 0 ? Matrix3d(Matrix3d::Identity()) : loop->turns[parents[i]];
      const Vector3d axis = snapped(turn.transpose() * Eigen::Map<const Vector3d>(axes + 6 * i));
      const Vector3d second = snapped(turn.transpose() * Eigen::Map<const Vector3d>(axes + 6 * i + 3));
      const std::string name = "joint" + std::to_string(i);
      pin::SE3 place(
        parent.transpose() * turn, parent.transpose() * Eigen::Map<const Vector3d>(points + 3 * i));
      loop->turns.push_back(turn);
      size_t id = parents[i] < 0 ? 0 : loop->ids[parents[i]];
      if (kinds[i] == CYLINDRICAL)
      {
        // Two joints with a massless link between them take less time than a composite joint.
        id = model.addJoint(id, joint_of(HINGE, axis, second), place, name + "turn");
        place.setIdentity();
      }
      id = model.addJoint(
        id, joint_of(kinds[i] == CYLINDRICAL ? SLIDE : kinds[i], axis, second), place, name);
      loop->ids.push_back(int(id));
      model.appendBodyToJoint(
        id, pin::Inertia(
              masses[i], turn.transpose() * Eigen::Map<const Vector3d>(centres + 3 * i),
              turn.transpose() * Eigen::Map<const Matrix3d>(inertias + 9 * i) * turn));
      loop->kinds.push_back(kinds[i]);
    }
    for (int l = 0; l < m; ++l)
    {
      const auto at = [&](int end) {
        const Vector3d anchor = Eigen::Map<const Vector3d>(anchors + 6 * l + 3 * end);
        const int body = loops[2 * l + end];
        // The frame of the constraint has the axes of the world at the start.
        const Matrix3d turn = body < 0 ? Matrix3d(Matrix3d::Identity()) : loop->turns[body];
        return pin::SE3(turn.transpose(), turn.transpose() * anchor);
      };
      const auto id = [&](int end) {
        return loops[2 * l + end] < 0 ? 0 : size_t(loop->ids[loops[2 * l + end]]);
      };
      loop->constraints.emplace_back(
        pin::CONTACT_3D, model, id(0), at(0), id(1), at(1));
      // Gaps decay like the deflection of a critically damped spring of this rate, 1/s.
      loop->constraints.back().m_baumgarte_parameters = {rate * rate, 2. * rate};
    }
    loop->data = std::make_unique<pin::Data>(model);
    for (const auto & constraint : loop->constraints)
      loop->constraint_data.emplace_back(constraint);
    if (m > 0 && embedded)
      pin::computeJointMinimalOrdering(model, *loop->data, loop->constraints);
    else if (m > 0)
      pin::initConstraintDynamics(model, *loop->data, loop->constraints, loop->constraint_data);
    loop->settings = pin::ProximalSettings(1e-14, mu, iterations);
    loop->embedded = embedded;
    loop->q_start = pin::neutral(model);
    loop->v_start = Eigen::Map<const VectorXd>(v, model.nv);
    loop->q = loop->q_stage = loop->q_start;
    loop->v = loop->v_stage = loop->v_start;
    loop->torque = loop->psi = VectorXd::Zero(model.nv);
    loop->k_q = loop->k_v = MatrixXd::Zero(model.nv, stages);
    loop->a = Eigen::Map<const Eigen::Matrix<double, -1, -1, Eigen::RowMajor>>(a, stages + 1, stages);
    loop->highest = highest;
    return loop;
  }

  void reset(Loop * loop)
  {
    loop->q = loop->q_start;
    loop->v = loop->v_start;
  }

  void advance(Loop * loop, double h, long steps)
  {
    for (long i = 0; i < steps; ++i)
      loop->step(h);
  }

  // rotations (n, 9) row-major, world axes; returns the largest distance of two ends of a loop, m
  double end_state(Loop * loop, double * rotations)
  {
    pin::forwardKinematics(loop->model, *loop->data, loop->q);
    for (size_t i = 0; i < loop->kinds.size(); ++i)
      Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotations + 9 * i) =
        loop->data->oMi[loop->ids[i]].rotation() * loop->turns[i].transpose();
    double gap = 0.;
    for (const auto & c : loop->constraints)
      gap = std::max(
        gap, (loop->data->oMi[c.joint1_id].act(c.joint1_placement.translation())
              - loop->data->oMi[c.joint2_id].act(c.joint2_placement.translation()))
               .norm());
    return gap;
  }

  void destroy(Loop * loop)
  {
    delete loop;
  }
}
