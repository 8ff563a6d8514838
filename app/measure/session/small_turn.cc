#include "app/measure/session/small_turn.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <random>

#include "app/measure/session/session_observer.h"
#include "app/system/temporary_folder.h"
#include "protocol/plan/rotation_plan.h"

namespace abcal {
namespace {

/// The file of the run, removed afterwards.
struct TemporaryFile {
  std::filesystem::path path =
      temporary_place() / fmt::format("abcal-check-{:08x}.run", std::random_device{}());
  TemporaryFile() = default;
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  ~TemporaryFile() {
    std::error_code ignored;
    for (const char* ending : {"", "-wal", "-shm"}) std::filesystem::remove(path.string() + ending, ignored);
  }
};

TurnedItem turned_item(const std::filesystem::path& path, std::size_t k) {
  const StoredRun stored = RunFile::load(path, static_cast<int>(k));
  TurnedItem item{stored.items.at(k - 1).reason, stored.header.expected.mounting, {}};
  if (!item.missing.empty()) return item;
  for (const DwellRecord& dwell : stored.record.dwells)
    item.poses.push_back({dwell.commanded_x, dwell.commanded_z, dwell.mean, dwell.spread,
                          dwell.u_mean.value_or(Eigen::Vector3d::Zero()), dwell.flags});
  return item;
}

}  // namespace

Eigen::Vector3d gravity_at(Angle x, Angle z) {
  return Eigen::AngleAxisd(-z.rad(), Eigen::Vector3d::UnitZ()) *
         (Eigen::AngleAxisd(-x.rad(), Eigen::Vector3d::UnitX()) * Eigen::Vector3d::UnitZ());
}

std::vector<TurnedItem> measure_small_turn(Bench& bench, const BenchConfig& config,
                                           const Identities& identities, const SessionListener& listener,
                                           const std::stop_token& stop) {
  const auto travel = identities.travel();
  const auto turn_of = [](const AxisTravel& t) {
    return Angle::degrees(t.max.deg() >= kSmallTurnDeg ? kSmallTurnDeg : -kSmallTurnDeg);
  };
  const Angle x = turn_of(travel[0]), z = turn_of(travel[1]);
  const std::vector<PlannedAngle> plan{
      {0, 1, false, Angle{}, Angle{}, Angle{}}, {0, 2, false, x, x, Angle{}}, {0, 3, false, z, x, z}};
  BenchConfig quick = config;
  quick.protocol.dwell_readings = std::min(config.protocol.dwell_readings, kMostTurnReadings);
  quick.protocol.warm_up_s = 0.0;
  quick.protocol.stability_s = 0.0;

  const TemporaryFile path;
  RunFile file = RunFile::create(path.path, make_header(quick, identities, plan, *bench.clock));
  if (listener) {
    RunBeganEvent began;  // Without a file.
    began.plan = plan;
    listener(began);
  }
  SessionObserver observer(listener);
  measure_plan({bench, quick, file, plan, {}}, observer, stop);
  std::vector<TurnedItem> turned;
  const std::size_t items = RunFile::load(path.path).items.size();
  for (std::size_t k = 1; k <= items; ++k) turned.push_back(turned_item(path.path, k));
  return turned;
}

}  // namespace abcal
