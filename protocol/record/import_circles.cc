#include "protocol/record/import_circles.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <optional>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "protocol/plan/faces.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/imported_dwells.h"
#include "protocol/record/table_comments.h"

namespace abcal {
namespace {

constexpr std::array<std::string_view, 3> kSpreadColumns{"spread_u", "spread_v", "spread_w"};
constexpr std::size_t kMostAngles = 100'000;

class CircleImporter {
 public:
  CircleImporter(TableReader& table, const TableColumns& columns, TableProblems& problems, RunRecord& record)
      : table_(table),
        columns_(columns),
        problems_(problems),
        record_(record),
        cells_(table, columns, problems) {}

  void import() {
    for (std::size_t rows = 1; cells_.next(); ++rows) {
      if (rows > kMostAngles) {
        problems_.add(fmt::format("line {}", cells_.line()), "another angle",
                      fmt::format("at most {} angles", kMostAngles));
        problems_.fail();
      }
      require_one_item();
      read_row();
    }
    record_.steps = 0;
    read_comments(table_, problems_, record_);
    refuse_radians();
    for (Problem& each : too_few_angles(record_.dwells))
      problems_.add(std::move(each.where), std::move(each.found), std::move(each.required));
    if (!columns_.has("closing")) mark_closing_angles(record_.dwells);
    // Drift, hysteresis and slow noise depend on the order of measurement.
    if (std::ranges::all_of(record_.dwells,
                            [](const DwellRecord& dwell) { return dwell.time_s.has_value(); }))
      record_.order_assumed = false;
    if (record_.steps == 0) infer_steps(record_);
  }

 private:
  /// A CSV of all items of a run has the column "item".
  void require_one_item() {
    if (!columns_.has("item")) return;
    if (!item_) item_ = cells_.text("item");
    if (cells_.text("item") == *item_ || other_item_) return;
    other_item_ = true;
    cells_.problem("item", as_quoted(cells_.text("item")),
                   "one item in the whole file: `abcal report RUN --item K --csv FILE` writes it");
  }

  void read_row() {
    DwellRecord dwell;
    const auto experiment =
        cells_.whole_number("experiment", 0, 3, "experiment 1, 2 or 3, or 0 for a check pose");
    const auto n = cells_.whole_number("n", 1, 1e6, "a whole number of at least 1");
    const auto alpha = cells_.number("alpha_deg");
    dwell.mean = cells_.readings();
    dwell.u_mean = cells_.uncertainties();
    dwell.time_s = cells_.optional_number("time_s");
    dwell.temperature_degc = cells_.optional_number("temperature_degc");
    for (std::size_t j = 0; j < 3; ++j)
      if (cells_.has(kSpreadColumns[j]))
        dwell.spread(static_cast<Eigen::Index>(j)) = cells_.optional_number(kSpreadColumns[j]).value_or(0.0);
    if (cells_.has("count")) {
      dwell.count = cells_.whole_number("count", 1, 1e15, "a whole number of at least 1").value_or(0);
    }
    if (cells_.has("flags")) {
      dwell.flags = static_cast<std::uint32_t>(
          cells_.whole_number("flags", 0, kAllFlags, "a sum of known flags").value_or(0));
    }
    if (cells_.has("closing"))
      dwell.closing = cells_.whole_number("closing", 0, 1, "0 or 1").value_or(0) == 1;
    if (cells_.has("face"))
      dwell.face = static_cast<int>(cells_.whole_number("face", 1, kFaces, "face 1 or 2").value_or(1));
    if (!experiment || !n || !alpha) return;
    dwell.experiment = static_cast<int>(*experiment);
    dwell.n = static_cast<int>(*n);
    dwell.alpha = Angle::degrees(*alpha);
    if (dwell.experiment == 0) {
      read_check_pose(std::move(dwell));
      return;
    }
    // A closing angle may have the n of the angle that it repeats: its alpha distinguishes it.
    const auto [first, is_new] =
        line_of_.emplace(std::make_tuple(dwell.experiment, dwell.n, *alpha >= 360.0), cells_.line());
    if (!is_new) {
      problems_.add(fmt::format("line {}", cells_.line()),
                    fmt::format("experiment {}, n = {} again (first on line {})", dwell.experiment, dwell.n,
                                first->second),
                    "each angle once");
      return;
    }
    set_commanded_angles(dwell);
    take_turns_of_encoder(dwell);
    record_.dwells.push_back(dwell);
  }

  /// Moves the commanded angles by the whole turns of the encoder angles, if the file has them.
  void take_turns_of_encoder(DwellRecord& dwell) {
    const auto near = [&](const char* column, Angle& commanded) {
      if (!cells_.has(column)) return;
      const auto encoder_deg = cells_.optional_number(column);
      if (encoder_deg && std::isfinite(*encoder_deg))
        commanded += Angle::degrees(360.0 * std::round((*encoder_deg - commanded.deg()) / 360.0));
    };
    near("encoder_x_deg", dwell.commanded_x);
    near("encoder_z_deg", dwell.commanded_z);
  }

  void read_check_pose(DwellRecord dwell) {
    const std::array<CheckPose, kCheckPoses> poses = check_poses();
    if (dwell.n > kCheckPoses) {
      problems_.add(fmt::format("line {}, n", cells_.line()), fmt::format("check pose {}", dwell.n),
                    "check pose 1 or 2");
      return;
    }
    const CheckPose& pose = poses[static_cast<std::size_t>(dwell.n - 1)];
    dwell.role = DwellRole::kCheck;
    dwell.commanded_x = pose.x;
    dwell.commanded_z = pose.z;
    take_turns_of_encoder(dwell);
    record_.check_poses.push_back({std::move(dwell), record_.dwells.size()});
  }

  /// Angles of whole circles that are parts of 2 pi are radians: read as degrees, they would look like
  /// missed steps.
  void refuse_radians() {
    std::vector<double> angles;
    for (const DwellRecord& dwell : record_.dwells) angles.push_back(std::abs(dwell.alpha.deg()));
    std::ranges::sort(angles);
    constexpr double kTurn = 2.0 * std::numbers::pi;
    // A circle of N angles ends at 2 pi (N - 1) / N, or at its closing angle.
    if (angles.empty() || angles.back() < 0.6 * kTurn || angles.back() > 1.01 * kTurn) return;
    constexpr double kWritten = 5e-3;  // Angles are often written with two decimals.
    double step = kTurn;
    for (std::size_t i = 1; i < angles.size(); ++i)
      if (const double apart = angles[i] - angles[i - 1]; apart > 2.0 * kWritten)
        step = std::min(step, apart);
    step = kTurn / std::round(kTurn / step);
    const bool parts_of_turn = std::ranges::all_of(angles, [&](double angle) {
      return std::abs(angle - step * std::round(angle / step)) <= 1.01 * kWritten;
    });
    const bool whole_degrees =
        std::ranges::all_of(angles, [](double angle) { return angle == std::round(angle); });
    if (!parts_of_turn || whole_degrees) return;
    constexpr double kDegrees = 360.0 / kTurn;
    problems_.add(
        "column alpha_deg",
        fmt::format("angles from 0 to {:.4g}, {:.4g} apart: parts of 2 pi, so they are radians; {:.4g} "
                    "is {:.4g} degrees",
                    angles.back(), step, angles.back(), kDegrees * angles.back()),
        "degrees: multiply every angle by 180/pi");
  }

  TableReader& table_;
  const TableColumns& columns_;
  TableProblems& problems_;
  RunRecord& record_;
  TableCells cells_;
  std::optional<std::string> item_;
  bool other_item_ = false;
  std::map<std::tuple<int, int, bool>, std::size_t> line_of_;
};

}  // namespace

void import_circles(TableReader& table, const TableColumns& columns, TableProblems& problems,
                    RunRecord& record) {
  CircleImporter(table, columns, problems, record).import();
}

}  // namespace abcal
