// Joint analyses of 3 x 72 angles from C++ and from Python, the same record in turns, and the published
// protocol in NumPy.
//   library_benchmark [--analyses N]      default 1000; prints the ratio of processor times at the end

#include <abcal/abcal.h>
#include <benchmark/benchmark.h>

#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iomanip>
#include <string>
#include <string_view>

namespace {

abcal::Record simulated_record() {
  abcal::SimulatedWorld world;
  world.item.sensitivity_matrix << 1.0, 0.05, 0.0, 0.0, 0.99, 0.01, -0.01, 0.0, 1.01;
  world.wobble_urad = 20.0;
  world.step_deg = 0.005;
  return abcal::simulate(world).record;
}

void BM_Joint(benchmark::State& state) {
  const abcal::Record record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(abcal::analyse(record, "joint"));
}
BENCHMARK(BM_Joint)->Unit(benchmark::kMillisecond);

void BM_Abc(benchmark::State& state) {
  const abcal::Record record = simulated_record();
  for (auto _ : state) benchmark::DoNotOptimize(abcal::analyse(record, "abc"));
}
BENCHMARK(BM_Abc)->Unit(benchmark::kMillisecond);

void write_csv(const abcal::Record& record, const std::filesystem::path& path) {
  std::ofstream file(path);
  file << std::setprecision(17) << "experiment,n,alpha_deg,r_u,r_v,r_w,u_u,u_v,u_w,time_s,closing\n";
  const auto experiment = record.experiment();
  const auto u = record.u();
  const auto time_s = record.time_s();
  const auto closing = record.closing();
  int n = 0;
  for (std::size_t i = 0; i < record.size(); ++i) {
    const auto row = static_cast<Eigen::Index>(i);
    n = i > 0 && experiment[i] == experiment[i - 1] ? n + 1 : 1;
    file << experiment[i] << ',' << n << ',' << record.alpha_deg()[row];
    for (int j = 0; j < 3; ++j) file << ',' << record.readings()(row, j);
    for (int j = 0; j < 3; ++j) file << ',' << u(row, j);
    file << ',' << time_s[i] << ',' << closing[i] << '\n';
  }
}

double processor_seconds(const abcal::Record& record, int analyses) {
  const std::clock_t begin = std::clock();
  for (int i = 0; i < analyses; ++i) benchmark::DoNotOptimize(abcal::analyse(record, "joint"));
  return static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
}

struct PythonSeconds {
  double joint = 0.0, reference = 0.0;
};

PythonSeconds python_seconds(const std::filesystem::path& csv, int analyses) {
  const std::string command = std::string(ABCAL_PYTHON_COMMAND) + " " + ABCAL_JOINT_SCRIPT + " " +
                              csv.string() + " " + std::to_string(analyses);
  std::FILE* const pipe = popen(command.c_str(), "r");
  PythonSeconds seconds;
  const bool read = pipe != nullptr && std::fscanf(pipe, "%lf %lf", &seconds.joint, &seconds.reference) == 2;
  if (pipe == nullptr || pclose(pipe) != 0 || !read) {
    std::fprintf(stderr, "failed: %s\n", command.c_str());
    std::exit(1);
  }
  return seconds;
}

/// In turns, so that both have the machine as it is.
void compare(int analyses) {
  constexpr int kRounds = 10;
  const std::filesystem::path csv = std::filesystem::temp_directory_path() / "abcal_library_benchmark.csv";
  write_csv(simulated_record(), csv);
  const abcal::Record record = abcal::load(csv);
  double cpp = 0.0;
  PythonSeconds python;
  for (int round = 0; round < kRounds; ++round) {
    cpp += processor_seconds(record, analyses / kRounds);
    const PythonSeconds seconds = python_seconds(csv, analyses / kRounds);
    python.joint += seconds.joint;
    python.reference += seconds.reference;
  }
  std::filesystem::remove(csv);
  std::printf("%d joint analyses of 3 x 72: C++ %.2f s, Python %.2f s, ratio %.3f\n", analyses, cpp,
              python.joint, python.joint / cpp);
  std::printf("%d fits of the published protocol in NumPy, without uncertainties: %.2f s\n", analyses,
              python.reference);
}

}  // namespace

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  int analyses = 1000;
  if (argc == 3 && std::string_view(argv[1]) == "--analyses") analyses = std::atoi(argv[2]);
  benchmark::RunSpecifiedBenchmarks();
  compare(analyses);
}
