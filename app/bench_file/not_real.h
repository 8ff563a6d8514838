#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "protocol/record/run_file.h"

namespace abcal {

/// Splits a reported serial number into single ones: a controller's stages "12/13", two controllers
/// "12 + 13", three voltmeters "12, 13, 14".
std::vector<std::string> single_serial_numbers(std::string_view reported);

/// Whether a reported serial number has a part for each instrument: false for "", for " + 13" (the first of
/// two controllers gave none), and for "12, 0" (IEEE 488.2, 10.14: a voltmeter that has none answers 0).
bool is_serial_number_reported(std::string_view reported);

/// Whether the emulated instruments of a driver report this single serial number; no real one does.
bool is_emulated_serial_number(std::string_view number, const std::string& driver);

/// The label of a run with the serial number that the bench file states for an instrument ("stage",
/// "accelerometer", "item-2") that reports none.
std::string stated_serial_number_label(const std::string& role);
/// The words with which the details of such an instrument end in a run.
std::string stated_serial_number_words(const std::string& serial_number);

/// Whether the port of at least one accelerometer that is to be opened is "simulated".
bool has_simulated_accelerometer(const BenchConfig& config);

/// Which of "stage" and "accelerometer" are simulated in a bench file, in whole or in part. An emulated
/// instrument on a pseudo-terminal cannot be distinguished from a real one and is not among them.
std::vector<std::string> simulated_instruments(const BenchConfig& config);

/// Which instruments of a run were not real ("stage", "accelerometer"): simulated by the bench file, or by an
/// emulator that the file's [simulation] or the serial numbers reveal.
std::vector<std::string> instruments_not_real(const RunHeader& header, const BenchConfig& bench);

}  // namespace abcal
