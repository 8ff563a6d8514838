// Cost of the witness for each dwell of a run: in the log alone, and through a process beside the run. The
// time of the wall is mostly that of the disk, which is the one of the folder for temporary files (TMPDIR).

#include <benchmark/benchmark.h>

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>

#include "app/system/helper_program.h"
#include "app/system/private_file.h"
#include "app/witness/witness_client.h"
#include "app/witness/witness_log.h"
#include "protocol/record/sha256.h"
#include "protocol/record/signature.h"
#include "tests/support/processor_time.h"
#include "tests/support/project_paths.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;

std::string link_of(std::int64_t k) {
  return sha256_of(std::to_string(k));
}

void BM_LinkInTheLog(benchmark::State& state) {
  const test::TemporaryFolder folder;
  WitnessLog log(folder / "witness.db", make_private_key(), [] { return WitnessMoment{}; });
  WitnessRequest request;
  request.run = "run-1";
  request.head = link_of(0);
  (void)log.answer(request, 0);
  request = {};
  request.what = WitnessAct::kLink;
  request.run = "run-1";
  for (auto _ : state) {
    ++request.k;
    request.previous = link_of(request.k - 1);
    request.now = link_of(request.k);
    benchmark::DoNotOptimize(log.answer(request, 0));
  }
}
BENCHMARK(BM_LinkInTheLog)->MeasureProcessCPUTime()->UseRealTime()->Unit(benchmark::kMicrosecond);

/// The processor time is that of the run's process; "witness_us" that of the witness, its start included.
void BM_LinkBesideARun(benchmark::State& state) {
  set_helper_folder(std::filesystem::path(test::abcal_program()).parent_path());
  const test::TemporaryFolder folder;
  write_private_file(folder / "key.pem", make_private_key());
  const double before_s = test::processor_seconds(RUSAGE_CHILDREN);
  std::optional<WitnessClient> client(std::in_place, folder / "key.pem", folder / "witness.db",
                                      WitnessClient::Limits{});
  (void)client->begin("run-1", "left", "A. B.", link_of(0), false);
  std::int64_t k = 0;
  for (auto _ : state) {
    ++k;
    client->post_link("run-1", k, link_of(k - 1), link_of(k));
    if (!client->wait_until_answered(std::chrono::seconds(60)) || !client->take_answers().at(0).line) {
      state.SkipWithError("no signature");
      break;
    }
  }
  client.reset();
  state.counters["witness_us"] =
      1e6 * (test::processor_seconds(RUSAGE_CHILDREN) - before_s) / static_cast<double>(k);
}
BENCHMARK(BM_LinkBesideARun)->MeasureProcessCPUTime()->UseRealTime()->Unit(benchmark::kMicrosecond);

}  // namespace

BENCHMARK_MAIN();
