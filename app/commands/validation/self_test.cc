#include "app/commands/validation/self_test.h"

#include <fmt/format.h>
#include <libxml/xmlversion.h>
#include <openssl/crypto.h>
#include <sqlite3.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <fstream>

#include "app/analysed_run/run_session.h"
#include "app/document/gnuplot.h"
#include "app/document/weasyprint.h"
#include "app/formats/xml_tree.h"
#include "app/laboratory/certificate/schema_check.h"
#include "app/laboratory/issuing/register_link.h"
#include "app/laboratory/register/login.h"
#include "app/measure/session/disk_space.h"
#include "app/measure/session/host_clock.h"
#include "app/results/analysis/analyses.h"
#include "app/results/analysis/recompute.h"
#include "app/system/helper_program.h"
#include "app/system/temporary_folder.h"
#include "app/system/version.h"
#include "app/witness/witness_client.h"
#include "protocol/gravity/local_gravity.h"
#include "protocol/record/signature.h"
#include "protocol/uncertainty/published_tables.h"
#include "protocol/uncertainty/simulation_sets.h"

namespace abcal {
namespace {

using Grade = SelfCheck::Grade;

constexpr std::uintmax_t kLeastDiskBytes = 200u << 20;  // Some ten runs of 72 angles.
constexpr double kLargestClockErrorS = 1.0;

// A bench with errors of stage and item, which the result must find.
constexpr const char* kBench = R"([bench]
name = "self-test"
g_loc_mps2 = 9.80101
g_loc_expanded_uncertainty_mps2 = 0.00003
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
rate_hz = 200.0
[environment]
temperature_degc = 23.0
[protocol]
steps = 12
step_deg = 30.0
settle_s = 0.05
dwell_readings = 20
[simulation]
noise = 1e-4
quantisation = 1e-6
sensitivity_matrix = [[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]
offset = [0.01, 0.02, 0.03]
zx = 1e-4
[simulation.x]
step_error_deg = 0.005
speed_deg_per_s = 100.0
[simulation.z]
step_error_deg = 0.005
speed_deg_per_s = 100.0
)";

/// Collects the checks and reports each.
class Report {
 public:
  explicit Report(const std::function<void(const SelfCheck&)>& tell) : tell_(tell) {}

  void group(std::string name) { group_ = std::move(name); }
  void add(std::string what, Grade grade, std::string found) {
    checks_.push_back({group_, std::move(what), grade, std::move(found)});
    if (tell_) tell_(checks_.back());
  }
  /// A check that throws is bad.
  template <class Check>
  void attempt(const std::string& what, const Check& check) {
    try {
      check();
    } catch (const std::exception& error) {
      add(what, Grade::kBad, error.what());
    }
  }
  std::vector<SelfCheck> take() { return std::move(checks_); }

 private:
  const std::function<void(const SelfCheck&)>& tell_;
  std::string group_;
  std::vector<SelfCheck> checks_;
};

void check_tool(Report& report, const Tool& tool, Grade if_absent) {
  const bool found = is_installed(tool);
  report.add(tool.program, found ? Grade::kGood : if_absent,
             found ? "installed" : fmt::format("not found; {} it: install {}", tool.needed_by, tool.package));
}

/// Checks a helper program: found, of this version, and able to start with its libraries.
void check_helper(Report& report, const Tool& helper) {
  const std::string name = std::filesystem::path(helper.program).filename().string();
  report.attempt(name, [&] {
    constexpr std::chrono::seconds kLongest{20};
    const ToolResult answer = run_tool_for_words(helper, {"--version"}, kLongest);
    const std::string required = fmt::format("{} {}", name, program_version());
    const bool good = answer.exit_code == 0 && answer.words == required;
    report.add(name, good ? Grade::kGood : Grade::kBad,
               good ? fmt::format("{} answers, of this version", helper.program)
                    : fmt::format("{}: found exit code {} and \"{}\"; required: \"{}\": install abcal anew",
                                  helper.program, answer.exit_code, answer.words, required));
  });
}

/// abcal-mpi is started by a person with mpirun, so that it is installed next to abcal, not among the
/// helpers.
Tool mpi_program() {
  return helper_program("abcal-mpi", "studies on several machines need");
}

void check_schemas(Report& report) {
  const std::filesystem::path folder = program_schemas();
  const DccSchema schema(folder);
  // A schema that accepts every document would be no check.
  const bool refuses =
      !schema
           .check(parse_xml("<dcc:digitalCalibrationCertificate xmlns:dcc=\"https://ptb.de/dcc\"/>", "empty"))
           .empty();
  report.add("schemas", refuses ? Grade::kGood : Grade::kBad,
             refuses ? fmt::format("{}: read, and an empty certificate is refused", folder.string())
                     : fmt::format("{}: found: an empty certificate passes; required: the schemas of DCC "
                                   "3.3.0: install abcal anew",
                                   folder.string()));
}

void check_ports(Report& report) {
  std::string usable, refused;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator("/dev", ignored)) {
    const std::string path = entry.path().string(), name = entry.path().filename().string();
    if (!name.starts_with("ttyUSB") && !name.starts_with("ttyACM") && !name.starts_with("usbtmc")) continue;
    std::string& list = ::access(path.c_str(), R_OK | W_OK) == 0 ? usable : refused;
    list.append(list.empty() ? "" : ", ").append(path);
  }
  if (!refused.empty()) {
    report.add("ports", Grade::kBad,
               fmt::format("{}: this user may not use them; required: the udev rules of abcal, or membership "
                           "in the group of the device",
                           refused));
  } else {
    report.add("ports", Grade::kGood, usable.empty() ? "no instrument is connected" : usable);
  }
}

void check_disk(Report& report) {
  const auto free = free_disk_space(std::filesystem::current_path() / "a.run");
  const bool good = !free || *free >= kLeastDiskBytes;
  report.add(
      "disk space here", good ? Grade::kGood : Grade::kBad,
      free ? fmt::format("{} MiB free; required: {}", *free >> 20, kLeastDiskBytes >> 20) : "not known");
}

void check_clock(Report& report, Clock::UtcTime now) {
  const HostClock clock = read_host_clock();
  // Nothing was measured before the program was written.
  const std::string utc = format_utc(now);
  if (utc < "2026") {
    report.add("clock", Grade::kBad, fmt::format("says {}; required: the time of today", utc));
  } else if (!clock.error_s) {
    report.add("clock", Grade::kNote, fmt::format("{}; no time service keeps it, or tells how well", utc));
  } else {
    report.add("clock", *clock.error_s <= kLargestClockErrorS ? Grade::kGood : Grade::kNote,
               fmt::format("{}; the time service states an error of at most {:.3g} s", utc, *clock.error_s));
  }
}

void check_register(Report& report, Clock::UtcTime now) {
  const std::string location = lab::register_location({});
  if (location.empty()) {
    report.add("register", Grade::kNote,
               "none is configured (ABCAL_REGISTER): names are stated, not verified");
    return;
  }
  lab::Register opened = lab::Register::open(location, now);
  std::string bad;
  for (const lab::RegisterFinding& finding : opened.verify())
    if (!finding.good) bad += fmt::format("{}{}: {}", bad.empty() ? "" : "; ", finding.what, finding.found);
  report.add("register", bad.empty() ? Grade::kGood : Grade::kBad,
             bad.empty() ? fmt::format("of {}, whole", opened.facts().name) : bad);
}

void check_installation(Report& report, Clock::UtcTime now) {
  report.group("installation");
  report.add("libraries", Grade::kGood,
             fmt::format("SQLite {}, {}, libxml2 {}", sqlite3_libversion(), OpenSSL_version(OPENSSL_VERSION),
                         LIBXML_DOTTED_VERSION));
  for (const auto& [name, needed_by] :
       {std::pair{"abcal-guard", "a stage that must halt if abcal dies needs"},
        {"abcal-pdf", "a PDF is written by"},
        {"abcal-sign", "XML signatures need"},
        {"abcal-hdf5", "HDF5 needs"},
        {"abcal-transfer", "messages and time stamps need"},
        {"abcal-witness", "a run that is signed while it is measured needs"}})
    check_helper(report, helper_program(name, needed_by));
  if (ABCAL_HAS_MPI != 0) check_helper(report, mpi_program());
  report.attempt("schemas", [&] { check_schemas(report); });
  check_tool(report, kGnuplot, Grade::kNote);
  check_tool(report, kWeasyPrint, Grade::kNote);
  check_ports(report);
  report.attempt("disk space here", [&] { check_disk(report); });
  check_clock(report, now);
  report.attempt("register", [&] { check_register(report, now); });
  report.attempt("witness", [&] {
    const std::unique_ptr<WitnessClient> witness = WitnessClient::find();
    report.add("witness", witness ? Grade::kGood : Grade::kNote,
               witness ? fmt::format("answers; its key has the fingerprint {}{}",
                                     fingerprint_of(witness->public_pem()),
                                     witness->is_beside() ? " and can be read by this user" : "")
                       : "none is configured: runs are not witnessed (docs/witness.md)");
  });
}

/// The largest difference from the printed values, in halves of the last printed digit. Printed values below
/// 1e-14 are the paper's round-off; ours need only be below 1e-14 as well.
double largest_difference(const StudyOutput& ours, const StudyOutput& printed) {
  constexpr double kRoundOff = 1e-14;
  constexpr double kPrintedDigits = 4.0;
  const OutputVector a = to_vector(ours), b = to_vector(printed);
  double largest = 0.0;
  for (int k = 0; k < kStudyOutputs; ++k) {
    if (!std::isfinite(b(k))) continue;
    const double size = std::abs(b(k));
    if (size < kRoundOff) {
      largest = std::max(largest, std::abs(a(k)) / kRoundOff);
    } else {
      const double half = 0.5 * std::pow(10.0, std::floor(std::log10(size)) - (kPrintedDigits - 1.0));
      largest = std::max(largest, std::abs(a(k) - b(k)) / half);
    }
  }
  return largest;
}

void check_tables(Report& report) {
  struct Table {
    const char *name, *set;
    std::size_t place;
    const StudyOutput& printed;
  };
  for (const Table& table : {Table{"table 5 of the paper", "3", 0, published_table_5()},
                             {"table 6", "4", 0, published_table_6()},
                             {"table 7", "5", 0, published_table_7()},
                             {"table 8", "6", 1, published_table_8()}}) {
    report.attempt(table.name, [&] {
      const StudyResult set = run_simulation_set(table.set, {});
      const double largest = largest_difference(set.cases.at(table.place).error.value(), table.printed);
      report.add(table.name, largest <= 1.001 ? Grade::kGood : Grade::kBad,
                 fmt::format("forward model and analysis differ from the printed numbers by at most {:.2f} "
                             "of half of the last digit",
                             largest));
    });
  }
}

void check_gravity(Report& report) {
  // Latitude, height: GRS80 in m/s2 (docs/theory/gravity.md).
  struct Place {
    double latitude_deg, height_m, value;
  };
  double largest = 0.0;
  for (const Place& place : {Place{0.0, 0.0, 9.7803267715},
                             {45.0, 0.0, 9.8061992025},
                             {90.0, 0.0, 9.8321863685},
                             {52.3, 80.0, 9.8124921225},
                             {45.0, 1000.0, 9.8031143762}})
    largest = std::max(
        largest, std::abs(formula_gravity(Angle::degrees(place.latitude_deg), place.height_m).value_mps2 -
                          place.value));
  report.add("local gravity by formula", largest <= 0.5001e-10 ? Grade::kGood : Grade::kBad,
             fmt::format("differs from the listed values by at most {:.1e} m/s2", largest));
}

/// Changes one byte in the middle of a file.
void damage(const std::filesystem::path& path) {
  std::filesystem::permissions(path, std::filesystem::perms::owner_write, std::filesystem::perm_options::add);
  std::fstream file(path, std::ios::in | std::ios::out | std::ios::binary);
  const auto middle = static_cast<std::streamoff>(std::filesystem::file_size(path) / 2);
  file.seekg(middle);
  const int byte = file.get();
  file.seekp(middle);
  file.put(static_cast<char>(byte ^ 1));
}

std::string bad_checks(const std::vector<IntegrityCheck>& checks) {
  std::string bad;
  for (const IntegrityCheck& check : checks)
    if (!check.good) bad += fmt::format("{}{}: {}", bad.empty() ? "" : "; ", check.what, check.found);
  return bad;
}

void check_run(Report& report) {
  report.group("run");
  const TemporaryFolder folder;
  const std::filesystem::path run = folder / "self-test.run";
  RunSession::Options options;
  options.laboratory = laboratory_link();
  RunSession session(std::move(options));
  const RunOutcome outcome = session.start({parse_bench(kBench, "the bench of the self-test"), run.string()});
  const CalibrationResult& result = outcome.items.front().result();
  report.add("simulated run", result.verdict == Verdict::kUsable ? Grade::kGood : Grade::kBad,
             fmt::format("{} angles, {} estimator: {} ({})", outcome.stored().measured.size(),
                         result.estimator, to_string(result.verdict), result.why));
  const TruthComparison truth =
      compare_with_truth(result, outcome.stored().record, parse_bench(kBench, "self-test"));
  report.add("result against the truth", truth.agrees() ? Grade::kGood : Grade::kBad,
             fmt::format("largest difference {:.2f} standard uncertainties; required: at most {:g}",
                         truth.largest, truth.allowed));
  const std::string bad = bad_checks(verify_and_recompute(run));
  report.add("verification", bad.empty() ? Grade::kGood : Grade::kBad,
             bad.empty() ? "hashes, chains, means, plan and result follow from the readings" : bad);
  damage(run);
  std::string found;
  try {
    found = bad_checks(verify_and_recompute(run));
  } catch (const std::exception& error) {
    found = error.what();
  }
  report.add("a changed byte is found", found.empty() ? Grade::kBad : Grade::kGood,
             found.empty() ? "it was not" : found.substr(0, 200));
}

}  // namespace

std::vector<SelfCheck> run_self_test(Clock::UtcTime now, const std::function<void(const SelfCheck&)>& tell) {
  Report report(tell);
  check_installation(report, now);
  report.group("method");
  check_tables(report);
  check_gravity(report);
  // The simulated run has no operator: it needs no login, no key, no authority.
  for (const char* name :
       {"ABCAL_REGISTER", "ABCAL_SIGNING_KEY", "ABCAL_WITNESS", "ABCAL_TIME_STAMP_AUTHORITY"})
    ::unsetenv(name);
  report.attempt("simulated run", [&] { check_run(report); });
  return report.take();
}

bool all_good(const std::vector<SelfCheck>& checks) {
  for (const SelfCheck& check : checks)
    if (check.grade == SelfCheck::Grade::kBad) return false;
  return !checks.empty();
}

}  // namespace abcal
