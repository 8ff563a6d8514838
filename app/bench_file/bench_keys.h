#pragma once

#include <string>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/formats/key_visitor.h"

namespace abcal {

/// Permitted values of [stage] driver, among them the empty one, for axes that have their own drivers.
std::vector<std::string> stage_driver_names();

/// Visits every key of a bench file. Reading, writing and the list of known keys follow from it: a new key is
/// one line in the function of its section, and its meaning one line in key_meanings.cc.
void visit_bench_file(KeyVisitor& keys, BenchConfig& config);

/// The keys of one [[fault]].
void visit_fault(KeyVisitor& keys, FaultConfig& fault);

/// The keys of one [[change]].
void visit_change(KeyVisitor& keys, ChangeConfig& change);

}  // namespace abcal
