#include "protocol/record/imported_dwells.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>

#include "protocol/plan/faces.h"

namespace abcal {
namespace {

constexpr std::size_t kFewestAngles = 3;  // A, B and C of one experiment
constexpr std::size_t kMostShown = 10;

std::string vector_text(const Eigen::Vector3d& v) {
  return fmt::format("({:g}, {:g}, {:g})", v.x(), v.y(), v.z());
}

void check_size(const char* name, std::size_t found, std::size_t required, std::vector<Problem>& problems) {
  if (found == required) return;
  problems.push_back({name, fmt::format("{} rows", found), fmt::format("{}, as alpha_deg has", required)});
}

std::vector<Problem> problems_of_sizes(const RecordRows& rows) {
  std::vector<Problem> problems;
  const std::size_t count = rows.alpha_deg.size();
  check_size("experiment", rows.experiment.size(), count, problems);
  check_size("readings", rows.mean.size(), count, problems);
  if (!rows.u_mean.empty()) check_size("u", rows.u_mean.size(), count, problems);
  if (!rows.time_s.empty()) check_size("time_s", rows.time_s.size(), count, problems);
  if (!rows.face.empty()) check_size("face", rows.face.size(), count, problems);
  return problems;
}

void check_row(const RecordRows& rows, std::size_t i, std::vector<Problem>& problems) {
  const auto where = [i](const char* name) { return fmt::format("{}, row {}", name, i); };
  if (rows.experiment[i] < 1 || rows.experiment[i] > 3)
    problems.push_back({where("experiment"), std::to_string(rows.experiment[i]), "1, 2 or 3"});
  if (!std::isfinite(rows.alpha_deg[i]))
    problems.push_back({where("alpha_deg"), fmt::format("{:g}", rows.alpha_deg[i]), "a finite number"});
  if (!rows.mean[i].allFinite())
    problems.push_back({where("readings"), vector_text(rows.mean[i]), "finite numbers"});
  if (!rows.u_mean.empty() && !(rows.u_mean[i].allFinite() && rows.u_mean[i].minCoeff() >= 0.0))
    problems.push_back({where("u"), vector_text(rows.u_mean[i]), "standard uncertainties >= 0"});
  if (!rows.time_s.empty() && !std::isfinite(rows.time_s[i]))
    problems.push_back({where("time_s"), fmt::format("{:g}", rows.time_s[i]), "a finite number"});
  if (!rows.face.empty() && (rows.face[i] < 1 || rows.face[i] > kFaces))
    problems.push_back({where("face"), std::to_string(rows.face[i]), "1 or 2"});
}

void throw_if_any(const std::vector<Problem>& problems, const std::string& source) {
  if (problems.empty()) return;
  std::string text;
  for (std::size_t i = 0; i < std::min(problems.size(), kMostShown); ++i)
    text += fmt::format("{}{}: {}", i == 0 ? "" : "\n", source, to_string(problems[i]));
  if (problems.size() > kMostShown)
    text += fmt::format("\n{}: and {} problems more", source, problems.size() - kMostShown);
  throw std::invalid_argument(text);
}

}  // namespace

void set_commanded_angles(DwellRecord& dwell) {
  const Angle turned = Angle::degrees(std::remainder(dwell.alpha.deg(), 360.0));
  const Angle held = held_angle(dwell.experiment, dwell.face);
  dwell.commanded_x = dwell.experiment == 3 ? held : turned;
  dwell.commanded_z = dwell.experiment == 3 ? turned : held;
}

void mark_closing_angles(std::vector<DwellRecord>& dwells) {
  std::map<std::pair<int, int>, double> smallest;  // of each experiment and face
  for (const DwellRecord& dwell : dwells) {
    double& least = smallest.try_emplace({dwell.experiment, dwell.face}, dwell.alpha.deg()).first->second;
    least = std::min(least, dwell.alpha.deg());
  }
  for (DwellRecord& dwell : dwells)
    dwell.closing = dwell.alpha.deg() - 360.0 == smallest.at({dwell.experiment, dwell.face});
}

std::vector<Problem> too_few_angles(const std::vector<DwellRecord>& dwells) {
  std::vector<Problem> problems;
  for (int experiment = 1; experiment <= 3; ++experiment) {
    std::set<double> angles;
    for (const DwellRecord& dwell : dwells) {
      if (dwell.experiment == experiment) angles.insert(std::remainder(dwell.alpha.deg(), 360.0));
    }
    if (angles.size() < kFewestAngles) {
      problems.push_back({fmt::format("experiment {}", experiment),
                          fmt::format("{} different angle{}", angles.size(), angles.size() == 1 ? "" : "s"),
                          fmt::format("at least {}", kFewestAngles)});
    }
  }
  return problems;
}

void infer_steps(RunRecord& record) {
  record.steps = 0;
  const DwellRecord* first = nullptr;
  const int next = has_two_faces(record) ? kFaces : 1;  // The angles of two faces interleave.
  for (const DwellRecord& dwell : record.dwells) {
    if (dwell.closing) continue;
    record.steps = std::max(record.steps, dwell.n);
    if (first == nullptr) {
      first = &dwell;
    } else if (dwell.experiment == first->experiment && dwell.n == first->n + next) {
      record.step = (dwell.alpha - first->alpha) * (1.0 / next);
      first = &dwell;
    }
  }
}

RunRecord record_of_rows(const RecordRows& rows, const std::string& source) {
  throw_if_any(problems_of_sizes(rows), source);
  std::vector<Problem> problems;
  for (std::size_t i = 0; i < rows.alpha_deg.size(); ++i) check_row(rows, i, problems);
  throw_if_any(problems, source);
  RunRecord record;
  record.source = source;
  record.dwells.resize(rows.alpha_deg.size());
  const int faces = std::ranges::count(rows.face, kFaces) > 0 ? kFaces : 1;
  std::array<std::array<int, kFaces>, 3> count{};
  for (std::size_t i = 0; i < rows.alpha_deg.size(); ++i) {
    DwellRecord& dwell = record.dwells[i];
    dwell.experiment = rows.experiment[i];
    if (!rows.face.empty()) dwell.face = rows.face[i];
    int& of_circle =
        count.at(static_cast<std::size_t>(dwell.experiment - 1)).at(static_cast<std::size_t>(dwell.face - 1));
    dwell.n = faces * of_circle++ + dwell.face;
    dwell.alpha = Angle::degrees(rows.alpha_deg[i]);
    dwell.mean = rows.mean[i];
    if (!rows.u_mean.empty()) dwell.u_mean = rows.u_mean[i];
    if (!rows.time_s.empty()) dwell.time_s = rows.time_s[i];
    set_commanded_angles(dwell);
  }
  throw_if_any(too_few_angles(record.dwells), source);
  mark_closing_angles(record.dwells);
  infer_steps(record);
  return record;
}

}  // namespace abcal
