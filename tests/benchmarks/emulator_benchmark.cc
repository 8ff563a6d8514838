// Eight benches at once: eight `abcal emulate` in processes of their own, each with a stage that is asked for
// its position 20 times a second and an accelerometer that streams at 100 Hz times the speed, over
// pseudo-terminals with real lines, or over TCP. A sample is late by its arrival minus its own time stamp,
// counted from the earliest one. Bytes through a pseudo-terminal wait for a worker of the kernel, which has
// no more priority than other programs, whatever that of the emulator is; those over TCP do not.

#include <benchmark/benchmark.h>
#include <fcntl.h>
#include <fmt/format.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "tests/support/processor_time.h"
#include "tests/support/program.h"
#include "tests/support/temporary_folder.h"

namespace {

using namespace abcal;
using namespace std::chrono_literals;
using std::chrono::steady_clock;

constexpr int kBenches = 8;
constexpr auto kListened = 60s;
constexpr auto kAskedEvery = 50ms;
constexpr double kLateMs = 10.0;
// Header, acceleration, reference time, checksum.
constexpr std::size_t kPacket = 30;
constexpr std::size_t kTimeAt = 20;

double seconds_between(steady_clock::time_point from, steady_clock::time_point to) {
  return std::chrono::duration<double>(to - from).count();
}

/// A connection to a port of this machine.
int connected(std::uint16_t port) {
  const int fd = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(port);
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const void* const generic = &address;
  if (::connect(fd, static_cast<const sockaddr*>(generic), sizeof address) != 0)
    throw std::runtime_error(fmt::format("cannot connect to port {}", port));
  const int on = 1;
  ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  ::fcntl(fd, F_SETFL, O_NONBLOCK);
  return fd;
}

/// A pseudo-terminal at 115200 Bd, or a TCP connection.
class Terminal {
 public:
  explicit Terminal(std::uint16_t port) : fd_(connected(port)) {}
  explicit Terminal(const std::filesystem::path& path)
      : fd_(::open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK)) {
    termios settings{};
    ::tcgetattr(fd_, &settings);
    ::cfmakeraw(&settings);
    ::cfsetspeed(&settings, B115200);
    ::tcsetattr(fd_, TCSANOW, &settings);
  }
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;
  ~Terminal() { ::close(fd_); }

  int fd() const { return fd_; }
  void read_into(std::string& bytes) const {
    std::array<char, 4096> buffer{};
    for (ssize_t size; (size = ::read(fd_, buffer.data(), buffer.size())) > 0;)
      bytes.append(buffer.data(), static_cast<std::size_t>(size));
  }
  void write(std::string_view bytes) const {
    if (::write(fd_, bytes.data(), bytes.size()) < 0) throw std::runtime_error("cannot write to a stage");
  }

 private:
  int fd_;
};

struct ServedBench {
  std::unique_ptr<test::Program> program;
  std::unique_ptr<Terminal> stage, accelerometer;
  std::string input;
  std::vector<double> offsets_s;  ///< Arrival minus time stamp of each packet.
  std::size_t lost = 0;
  std::uint64_t last_ns = 0;
  bool asked = false;
  steady_clock::time_point asked_at;
  std::vector<double> answers_ms;

  void take_packets(steady_clock::time_point start, double speed) {
    accelerometer->read_into(input);
    const double now_s = seconds_between(start, steady_clock::now());
    std::size_t at = 0;
    for (; (at = input.find("\x75\x65\x80", at)) != std::string::npos && at + kPacket <= input.size();
         at += kPacket) {
      std::uint64_t ns = 0;
      for (std::size_t n = 0; n < 8; ++n) ns = ns << 8U | static_cast<unsigned char>(input[at + kTimeAt + n]);
      if (last_ns != 0) lost += static_cast<std::size_t>((ns - last_ns + 5'000'000) / 10'000'000) - 1;
      last_ns = ns;
      offsets_s.push_back(now_s - static_cast<double>(ns) * 1e-9 / speed);
    }
    // The beginning of a packet may be at the end.
    input.erase(0, at != std::string::npos ? at : input.size() - std::min<std::size_t>(input.size(), 2));
  }
  void take_answer() {
    std::string bytes;
    stage->read_into(bytes);
    if (bytes.find('\n') == std::string::npos) return;
    asked = false;
    answers_ms.push_back(1e3 * seconds_between(asked_at, steady_clock::now()));
  }
  void ask() {
    if (asked) return;
    asked = true;
    asked_at = steady_clock::now();
    stage->write("POS? 1\n");
  }
};

double quantile(std::vector<double> values, double p) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

/// The port behind "INSTRUMENT: ... on tcp:127.0.0.1:".
std::uint16_t port_of(const std::string& out, const std::string& instrument) {
  constexpr std::string_view kBefore = " on tcp:127.0.0.1:";
  const std::size_t at = out.find(kBefore, out.find(instrument + ": "));
  if (at == std::string::npos) throw std::runtime_error(instrument + " is on no TCP port");
  return static_cast<std::uint16_t>(std::stoi(out.substr(at + kBefore.size())));
}

std::unique_ptr<ServedBench> serve(const test::TemporaryFolder& folder, int number, double speed, bool tcp) {
  const std::string name = fmt::format("bench-{}", number);
  const std::string port = tcp ? "tcp:127.0.0.1:0" : "simulated";
  test::write_file(folder / (name + ".toml"),
                   "[bench]\ng_loc_mps2 = 9.81\n[stage]\ndriver = \"pi_gcs\"\nport = \"" + port +
                       "\"\n"
                       "[accelerometer]\ndriver = \"microstrain_mip\"\nport = \"" +
                       port +
                       "\"\n"
                       "[emulator]\nat_power_on = \"streaming\"\n[simulation]\nnoise = 1e-4\n");
  auto bench = std::make_unique<ServedBench>();
  bench->program =
      std::make_unique<test::Program>(std::vector<std::string>{"emulate", name + ".toml", "--link-dir", name,
                                                               "--speed", fmt::format("{}", speed)},
                                      folder.path());
  if (!test::wait_for([&] { return bench->program->out().find("Serving") != std::string::npos; }, 60s))
    throw std::runtime_error(bench->program->err());
  if (tcp) {
    bench->stage = std::make_unique<Terminal>(port_of(bench->program->out(), "stage"));
    bench->accelerometer = std::make_unique<Terminal>(port_of(bench->program->out(), "accelerometer"));
    return bench;
  }
  bench->stage = std::make_unique<Terminal>(folder / name / "stage");
  bench->accelerometer = std::make_unique<Terminal>(folder / name / "accelerometer");
  return bench;
}

void listen(std::vector<std::unique_ptr<ServedBench>>& benches, double speed) {
  std::vector<pollfd> polled;
  for (const auto& bench : benches) {
    polled.push_back({bench->accelerometer->fd(), POLLIN, 0});
    polled.push_back({bench->stage->fd(), POLLIN, 0});
  }
  const auto start = steady_clock::now();
  auto next_question = start;
  while (steady_clock::now() - start < kListened) {
    ::poll(polled.data(), polled.size(), 10);
    for (std::size_t n = 0; n < benches.size(); ++n) {
      if (polled[2 * n].revents != 0) benches[n]->take_packets(start, speed);
      if (polled[2 * n + 1].revents != 0) benches[n]->take_answer();
    }
    if (steady_clock::now() < next_question) continue;
    for (const auto& bench : benches) bench->ask();
    next_question += kAskedEvery;
  }
}

void BM_EightBenches(benchmark::State& state) {
  const double speed = static_cast<double>(state.range(0)) / 10.0;
  for (auto _ : state) {
    const test::TemporaryFolder folder;
    std::vector<std::unique_ptr<ServedBench>> benches;
    for (int n = 0; n < kBenches; ++n) benches.push_back(serve(folder, n, speed, state.range(1) != 0));
    listen(benches, speed);
    const double cpu_before_s = test::processor_seconds(RUSAGE_CHILDREN);
    std::vector<double> late_ms;
    std::vector<double> answers_ms;
    std::size_t lost = 0;
    for (const auto& bench : benches) {
      bench->program->signal(SIGINT);
      bench->program->wait();
      // Messages of the first second waited in the terminal before it was read.
      const auto skipped = std::min(bench->offsets_s.size(), static_cast<std::size_t>(100.0 * speed) + 1);
      bench->offsets_s.erase(bench->offsets_s.begin(),
                             bench->offsets_s.begin() + static_cast<std::ptrdiff_t>(skipped));
      const double earliest = quantile(bench->offsets_s, 0.0);
      for (const double offset : bench->offsets_s) late_ms.push_back(1e3 * (offset - earliest));
      answers_ms.insert(answers_ms.end(), bench->answers_ms.begin(), bench->answers_ms.end());
      lost += bench->lost;
    }
    const double listened_s = std::chrono::duration<double>(kListened).count();
    state.counters["samples"] = static_cast<double>(late_ms.size());
    state.counters["samples_per_s"] = static_cast<double>(late_ms.size()) / listened_s / kBenches;
    state.counters["lost"] = static_cast<double>(lost);
    state.counters["late_p50_ms"] = quantile(late_ms, 0.5);
    state.counters["late_p999_ms"] = quantile(late_ms, 0.999);
    state.counters["late_max_ms"] = quantile(late_ms, 1.0);  // Required: below 10 ms at speed 1.
    state.counters["beyond_10ms"] =
        static_cast<double>(std::ranges::count_if(late_ms, [](double ms) { return ms > kLateMs; }));
    state.counters["answer_p50_ms"] = quantile(answers_ms, 0.5);
    state.counters["answer_max_ms"] = quantile(answers_ms, 1.0);
    // Processor time of all eight, including their start.
    state.counters["cpu_percent"] =
        100.0 * (test::processor_seconds(RUSAGE_CHILDREN) - cpu_before_s) / listened_s;
  }
}
BENCHMARK(BM_EightBenches)
    ->ArgNames({"tenths_of_real_speed", "tcp"})
    ->Args({1, 0})
    ->Args({10, 0})
    ->Args({10, 1})
    ->Args({200, 0})
    ->Iterations(1)
    ->Unit(benchmark::kSecond);

}  // namespace

BENCHMARK_MAIN();
