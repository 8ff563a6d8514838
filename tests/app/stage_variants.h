#pragma once

#include <fmt/format.h>

#include <array>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/bench_file/stage_description_file.h"
#include "drivers/instrument/mounted_stage.h"
#include "drivers/registry.h"
#include "tests/support/project_paths.h"

namespace abcal {

/// A stage driver with one controller for both axes, or with two in a daisy chain.
struct StageVariant {
  std::string name;  ///< "pi_gcs", "pi_gcs_chain"
  const StageDriver* driver;
  std::array<std::string, 2> axis_names = StageSettings{}.axis_names;
  std::string description{};                 ///< The name of a shipped one; empty: no described stage.
  std::optional<double> units_per_degree{};  ///< Where the description leaves them to the bench file.
  bool wraps = false;                        ///< It counts modulo 360.

  StageSettings settings() const {
    StageSettings settings;
    settings.axis_names = axis_names;
    settings.units_per_degree = {units_per_degree, units_per_degree};
    if (!description.empty())
      settings.description = std::make_shared<const StageDescription>(stage_description_of(config().stage));
    return settings;
  }
  BenchConfig config() const {
    BenchConfig config;
    config.stage.driver = driver->name;
    config.stage.x.axis = axis_names[0];
    config.stage.z.axis = axis_names[1];
    config.stage.x.units_per_degree = config.stage.z.units_per_degree = units_per_degree;
    config.stage.description = description;
    for (StageAxisConfig* axis : {&config.stage.x, &config.stage.z}) {
      if (!wraps) continue;
      axis->wraps_deg = 360.0;
      axis->travel_min_deg = -kTravelDeg;
      axis->travel_max_deg = kTravelDeg;
    }
    return config;
  }
  /// The lines of [stage] and of its axes in a bench file, but for the port.
  std::string section() const {
    std::string lines = "driver = \"" + driver->name + "\"\n";
    if (!description.empty()) lines += "description = \"" + description + "\"\n";
    for (std::size_t k = 0; k < 2; ++k) {
      lines += std::string(k == 0 ? "[stage.x]" : "[stage.z]") + "\naxis = \"" + axis_names[k] + "\"\n";
      if (wraps) lines += fmt::format("travel_min_deg = -{0}\ntravel_max_deg = {0}\n", kTravelDeg);
      if (units_per_degree) lines += "units_per_degree = " + std::to_string(*units_per_degree) + "\n";
    }
    return lines;
  }
  std::unique_ptr<RotationStage> make(std::vector<std::unique_ptr<wire::ByteStream>> streams,
                                      Clock& clock) const {
    auto stage = driver->make(std::move(streams), clock, settings());
    if (!wraps) return stage;
    // The turns are counted above the driver.
    const AxisMounting mounting{Angle{}, +1, Angle::degrees(-kTravelDeg), Angle::degrees(kTravelDeg), true};
    return std::make_unique<MountedStage>(std::move(stage), std::array{mounting, mounting});
  }
  static constexpr double kTravelDeg = 360.0;
};

/// Every stage driver of the registry, those that make daisy chains also with a chain, and every shipped
/// description, with the first two names of its axes.
inline const std::vector<StageVariant>& stage_variants() {
  static const std::vector<StageVariant> all = [] {
    std::vector<StageVariant> variants;
    for (const StageDriver& driver : stage_drivers()) variants.push_back({driver.name, &driver});
    for (const StageDriver& driver : stage_drivers())
      if (driver.axes_on_line) variants.push_back({driver.name + "_chain", &driver, {"1 1", "2 1"}});
    for (const ShippedDescription& shipped : shipped_descriptions()) {
      StageVariant variant{"described_" + std::string(shipped.name), &described_stage_drivers().front()};
      variant.description = shipped.name;
      const StageDescription description = stage_description_of(variant.config().stage);
      if (description.scale_in_bench) variant.units_per_degree = 1000.0;
      variant.wraps = description.wraps;
      if (description.axis_names.size() >= 2)
        variant.axis_names = {description.axis_names[0], description.axis_names[1]};
      variants.push_back(std::move(variant));
    }
    return variants;
  }();
  return all;
}

inline const StageVariant& stage_variant(const std::string& name) {
  for (const StageVariant& variant : stage_variants())
    if (variant.name == name) return variant;
  throw std::invalid_argument("no stage driver is called \"" + name + "\"");
}

inline std::vector<std::string> names_of_stage_variants() {
  std::vector<std::string> names;
  for (const StageVariant& variant : stage_variants()) names.push_back(variant.name);
  return names;
}

/// Controllers that are made up, each described from its manual, the comment at the head of its file; and the
/// shipped descriptions.
inline std::vector<std::string> made_up_and_shipped() {
  std::vector<std::string> all;
  for (const auto& file :
       std::filesystem::directory_iterator(test::source_folder() / "tests/drivers/described/made_up"))
    all.push_back(file.path().string());
  for (const ShippedDescription& shipped : shipped_descriptions()) all.emplace_back(shipped.name);
  return all;
}

}  // namespace abcal
