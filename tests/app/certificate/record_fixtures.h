#pragma once

#include <fmt/format.h>

#include <string>

#include "tests/app/certificate/certificate_fixtures.h"

namespace abcal {

/// How an item is mounted, and its matrix on the platter.
struct Mounting {
  const char* words;
  const char* matrix;
};
inline constexpr Mounting kAsIs{
    "x y z", "[[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]"};
inline constexpr Mounting kAboutX{
    "x -z y", "[[1.0021, 0.0037, 0.0047], [0.0069, 0.0086, -0.9982], [-0.0117, 1.0009, -0.0064]]"};

/// For bench_of(): the stage has the record "b.stage".
inline constexpr const char* kRecord = "record = \"b.stage\"\n";

/// A bench whose stage repeats its errors, so that a record of it tells something.
inline std::string bench_of(const std::string& serial_number, const Mounting& mounting, int run,
                            const std::string& stage = "", int seed = 7) {
  std::string bench = replaced(certificate_bench(), "serial_number = \"SN-42\"",
                               fmt::format("serial_number = \"{}\"", serial_number));
  bench = replaced(bench, "range = \"8 g\"\n",
                   fmt::format("range = \"8 g\"\nmounting = \"{}\"\n", mounting.words));
  bench = replaced(bench, "[accelerometer]\n", stage + "[accelerometer]\n");
  bench = replaced(bench, "[protocol]\n", "[protocol]\nestimator = \"joint\"\n");
  bench =
      replaced(bench, "[simulation]\n",
               fmt::format("[item_uncertainty]\ndrift_between_runs = 2e-6\n[simulation]\nseed = {}\nrun = "
                           "{}\nfloor_repeatability_urad = 5.0\n",
                           seed, run));
  bench = replaced(bench, kAsIs.matrix, mounting.matrix);
  for (int axis = 0; axis < 2; ++axis)
    bench = replaced(bench, "step_error_deg = 0.005\n",
                     "fine_map_deg = 0.008\nstep_repeatability_deg = 0.0005\nhoming_repeatability_deg = "
                     "0.001\nsmooth_error_deg = 0.004\nwobble_urad = 40.0\n");
  return bench;
}

/// The record of a laboratory file.
inline std::string record_entry(const std::string& sha256, const std::string& performed = "2000-01-01",
                                const std::string& due = "2000-06-30") {
  return fmt::format(
      "[[equipment]]\nname = \"Errors of the stage\"\nserial_number = \"118001234\"\nquantity = \"stage "
      "record\"\ncertificate = \"SR-1\"\ncertificate_issuer = \"Approver N. N.\"\ncertificate_sha256 = "
      "\"{}\"\nperformed = {}\ndue = {}\n",
      sha256, performed, due);
}

}  // namespace abcal
