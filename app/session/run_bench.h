#pragma once

#include <array>
#include <cstddef>
#include <set>
#include <string>
#include <vector>

#include "app/bench/bench_config.h"
#include "app/bench/make_bench.h"
#include "app/bench/real_clock.h"
#include "app/system/progress.h"
#include "protocol/plan/rotation_plan.h"
#include "protocol/record/run_file.h"
#include "protocol/run/experiment_run.h"

namespace abcal {

/// Shows a run on the terminal's last line.
class TerminalObserver final : public RunObserver {
 public:
  TerminalObserver(std::string title, const std::vector<PlannedAngle>& plan, std::set<std::size_t> measured);

  void phase(std::size_t position, RunPhase phase) override;
  void dwell(std::size_t position, const DwellRecord& dwell) override;
  void notice(std::string_view, std::string_view text) override;
  void finish() { bar_.clear(); }
  std::size_t measured() const { return measured_.size(); }

 private:
  RealClock clock_;  // People live in real time, also when the run's time is simulated.
  const std::vector<PlannedAngle>& plan_;
  std::set<std::size_t> measured_;  ///< Positions in the plan.
  ProgressBar bar_;
};

/// What the instruments said before the first move.
struct Identities {
  StageInfo stage;
  AccelerometerInfo accelerometer;

  std::array<AxisTravel, 2> travel() const;
};

/// Identifies both instruments and compares them with what the bench file requires.
/// @throws InstrumentError kWrongIdentity
Identities identify(Bench& bench, const BenchConfig& config);

/// Refuses an instrument whose serial number is not `required` (empty: any will do).
/// @throws InstrumentError kWrongIdentity
void require_serial_number(const std::string& role, const std::string& model, const std::string& found,
                           const std::string& required);

/// What a run file holds before the first angle.
RunHeader make_header(const BenchConfig& config, const Identities& who, std::vector<PlannedAngle> plan,
                      const Clock& clock);

/// "a.run" given, or "BENCH-20260301T120000Z<extension>" here.
std::filesystem::path output_path(const std::string& given, const std::string& bench_file,
                                  const std::string& extension);

/// Stores temperature, humidity and pressure as the sensor says, or as typed into the bench file. At the
/// start a sensor that fails throws InstrumentError; at the end of a run it is noted only: nothing is lost
/// for it.
void note_environment(Bench& bench, const BenchConfig& config, RunFile& file, std::string_view moment);

/// Measures what is missing of the plan. In real time `stop` halts the stage at once, whatever the measuring
/// thread waits for: the halt is sent by the thread that requests the stop.
RunTiming measure(Bench& bench, const BenchConfig& config, RunFile& file,
                  const std::vector<PlannedAngle>& plan, const RunProgress& so_far, RunObserver& observer,
                  const std::stop_token& stop);

/// The same for a person at the terminal. In real time an interrupt halts the stage at once, whatever the
/// measuring thread waits for. On failure the person is told how much is kept, and `on_failure` (nothing: the
/// file is of no further use), and the exception goes on.
RunTiming measure(Bench& bench, const BenchConfig& config, RunFile& file,
                  const std::vector<PlannedAngle>& plan, const RunProgress& so_far, const std::string& title,
                  const std::optional<std::string>& on_failure);

}  // namespace abcal
