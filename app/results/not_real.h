#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "app/bench/bench_config.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// The single serial numbers of what an instrument reported: a controller's stages "12/13", two controllers
/// "12 + 13", three voltmeters "12, 13, 14".
std::vector<std::string> single_serial_numbers(std::string_view reported);

/// Which instruments of a run were not real ("stage", "accelerometer"): simulated by the bench file, or by an
/// emulator that the file's [simulation] or the serial numbers give away.
std::vector<std::string> instruments_not_real(const RunHeader& header, const BenchConfig& bench);

}  // namespace abcal
