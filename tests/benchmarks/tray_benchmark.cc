// A run of several items, 3 x 72 angles, from the records to all results: with the search for each item's
// noise, its own tests and the common fit. The cost grows with the number of items.

#include <benchmark/benchmark.h>

#include "protocol/estimators/joint/analyse_tray.h"
#include "tests/protocol/estimators/made_tray.h"

namespace {

using namespace abcal;

void BM_Tray(benchmark::State& state) {
  const test::MadeTray tray =
      test::made_tray({.items = static_cast<std::size_t>(state.range(0)), .steps = 72}, 1);
  for (auto _ : state) benchmark::DoNotOptimize(analyse_tray(tray.records));
}
BENCHMARK(BM_Tray)
    ->Arg(1)
    ->Arg(2)
    ->Arg(4)
    ->Arg(8)
    ->Arg(16)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime()
    ->MeasureProcessCPUTime();

}  // namespace

BENCHMARK_MAIN();
