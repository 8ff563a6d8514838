// Calibrates on the factory's stage.   calibrate BENCH.toml RUN

#include <abcal/abcal.h>

#include <cstdio>
#include <exception>
#include <memory>

#include "factory_stage.h"

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  try {
    // From here on a bench file may say driver = "factory_stage".
    abcal::add_stage_driver({
        .name = "factory_stage",
        .description = "turntable of the factory",
        .serial = {},
        .make = [](auto, abcal::Clock& clock,
                   const abcal::StageSettings& settings) -> std::unique_ptr<abcal::RotationStage> {
          return std::make_unique<factory::Stage>(clock, settings.speed_deg_per_s[0].value_or(20.0));
        },
        .connections = 0,  // The maker's library opens the port.
    });
    abcal::Bench bench(argv[1]);
    int angles = 0;
    const abcal::CompleteRun run = bench.run(argv[2], [&](const abcal::Event& event) {
      if (event.name == "dwell_done") ++angles;
    });
    std::printf("%d angles, %s\n", angles, run.result.estimator().c_str());
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "calibrate: %s\n", error.what());
    return 1;
  }
}
