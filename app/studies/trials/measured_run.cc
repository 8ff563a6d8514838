#include "app/studies/trials/measured_run.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"
#include "sim/sim_accelerometer.h"
#include "sim/sim_clock.h"
#include "sim/sim_stage.h"

namespace abcal {
namespace {

class NobodyWatches final : public RunObserver {
  void phase(std::size_t /*position*/, RunPhase /*phase*/) override {}
  void dwells(std::size_t /*position*/, std::span<const ItemDwell> /*dwells*/) override {}
  void notice(std::string_view /*kind*/, const Message& /*text*/, std::optional<int> /*item*/) override {}
};

/// A file that is removed with this object, in memory where the system supports it.
class PassingFile {
 public:
  explicit PassingFile(std::uint64_t number)
      : path_(folder() / fmt::format("abcal-study-{}-{}.run", ::getpid(), number)) {
    remove();
  }
  PassingFile(const PassingFile&) = delete;
  PassingFile& operator=(const PassingFile&) = delete;
  ~PassingFile() { remove(); }
  const std::filesystem::path& path() const { return path_; }

 private:
  static std::filesystem::path folder() {
    const std::filesystem::path memory = "/dev/shm";
    return ::access(memory.c_str(), W_OK) == 0 ? memory : std::filesystem::temp_directory_path();
  }
  void remove() const {
    std::error_code ignored;
    for (const char* suffix : {"", "-wal", "-shm"}) std::filesystem::remove(path_.string() + suffix, ignored);
  }
  std::filesystem::path path_;
};

/// The mean over the time from the first angle to the last, which is the measurand: the mean over the angles
/// themselves differs by the square of their distance.
sim::TrueLineResponse mean_truth(const sim::SimBench& world, const RunRecord& record) {
  constexpr int kTimes = 1000;
  sim::TrueLineResponse mean{Eigen::Matrix3d::Zero(), Eigen::Vector3d::Zero()};
  double first = record.dwells.front().time_s.value_or(0.0), last = first;
  for (const DwellRecord& dwell : record.dwells) {
    first = std::min(first, dwell.time_s.value_or(first));
    last = std::max(last, dwell.time_s.value_or(last));
  }
  for (int k = 0; k < kTimes; ++k) {
    const double time_s = first + (last - first) * (k + 0.5) / kTimes;
    const sim::TrueLineResponse at = world.true_line_response(world.start() + from_seconds(time_s));
    mean.sensitivity_matrix += at.sensitivity_matrix / kTimes;
    mean.offset += at.offset / kTimes;
  }
  return mean;
}

}  // namespace

MeasuredRecords measure_bench(const StudyBench& bench, std::uint64_t number) {
  sim::SimClock clock;
  std::vector<std::shared_ptr<sim::SimBench>> worlds;
  std::vector<std::unique_ptr<sim::SimAccelerometer>> accelerometers;
  const std::array<AxisTravel, 2> travel{AxisTravel{bench.stage.x.travel_min, bench.stage.x.travel_max},
                                         AxisTravel{bench.stage.z.travel_min, bench.stage.z.travel_max}};
  RunHeader header;
  header.response_unit = "R";
  header.step = bench.protocol.step;
  header.steps = bench.protocol.steps;
  header.approach = bench.protocol.approach;
  header.plan = make_rotation_plan(bench.protocol, travel);
  RunSettings settings;
  settings.protocol = bench.protocol;
  const bool several = bench.items.size() > 1;
  for (std::size_t k = 0; k < bench.items.size(); ++k) {
    const StudyItem& item = bench.items[k];
    sim::ItemTruth truth;
    static_cast<sim::OutputTruth&>(truth) = item.truth;
    truth.seed = several ? sim::item_seed(bench.stage.seed, static_cast<int>(k)) : bench.stage.seed;
    worlds.push_back(k == 0 ? std::make_shared<sim::SimBench>(truth, bench.stage, clock.now())
                            : worlds.front()->add_item(truth));
    accelerometers.push_back(std::make_unique<sim::SimAccelerometer>(worlds.back(), clock, item.reading_hz,
                                                                     "R", fmt::format("SIM-{}", k + 1)));
    if (k == 0) {
      header.tolerances = settings.tolerances = item.sizes;
      header.expected = settings.expected = item.expected;
    } else {
      ItemFacts& facts = header.further_items.emplace_back();
      facts.response_unit = "R";
      facts.tolerances = item.sizes;
      facts.expected = item.expected;
    }
    if (several) header.items.emplace_back().k = static_cast<int>(k) + 1;
  }
  sim::SimStage stage(worlds.front(), clock);
  RunInstruments instruments{stage, clock, {}, several};
  for (std::size_t k = 0; k < bench.items.size(); ++k)
    instruments.items.push_back({static_cast<int>(k) + 1, *accelerometers[k], bench.items[k].limits,
                                 bench.items[k].sizes, bench.items[k].expected});
  const PassingFile passing(number);
  MeasuredRecords out;
  {
    RunFile file = RunFile::create(passing.path(), header);
    file.begin_session({clock.utc_now(), clock.now(), {}, {}, true});
    NobodyWatches nobody;
    out.time_s = run_experiments(instruments, {header.plan, settings, {}}, file, nobody, {}).total_s();
  }
  for (std::size_t k = 0; k < bench.items.size(); ++k) {
    out.items.push_back(RunFile::load(passing.path(), static_cast<int>(k) + 1).record);
    out.truths.push_back(mean_truth(*worlds[k], out.items.back()));
  }
  return out;
}

}  // namespace abcal
