#include "app/studies/trials/mpi_team.h"

#include <fmt/format.h>
#include <mpi.h>

#include <array>
#include <chrono>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <thread>

#include "app/system/output.h"

namespace abcal {
namespace {

constexpr int kLeader = 0;
// Tags: of a result or failure, of its note; a thread's requests and replies have one of their own from kHand
// on.
constexpr int kResult = 0, kNote = 1, kThreads = 2, kHand = 3;
constexpr std::uint64_t kNoMore = 0;  // a request for no trials

// Waits without the busy loop of MPI_Wait, which would take a core from the trials.
void wait_for(MPI_Request& request) {
  int done = 0;
  while (true) {
    MPI_Test(&request, &done, MPI_STATUS_IGNORE);
    if (done != 0) return;
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  }
}

template <class T>
MPI_Datatype type_of();
template <>
MPI_Datatype type_of<double>() {
  return MPI_DOUBLE;
}
template <>
MPI_Datatype type_of<char>() {
  return MPI_CHAR;
}
template <>
MPI_Datatype type_of<std::uint64_t>() {
  return MPI_UINT64_T;
}

template <class T>
void send(const T* data, std::size_t count, int to, int tag) {
  MPI_Request request{};
  MPI_Isend(data, static_cast<int>(count), type_of<T>(), to, tag, MPI_COMM_WORLD, &request);
  wait_for(request);
}

template <class T>
void receive(T* data, std::size_t count, int from, int tag) {
  MPI_Request request{};
  MPI_Irecv(data, static_cast<int>(count), type_of<T>(), from, tag, MPI_COMM_WORLD, &request);
  wait_for(request);
}

// A message whose length only its sender knows.
template <class T>
std::vector<T> receive_all(int from, int tag) {
  MPI_Status status{};
  int there = 0;
  while (true) {
    MPI_Iprobe(from, tag, MPI_COMM_WORLD, &there, &status);
    if (there != 0) break;
    std::this_thread::sleep_for(std::chrono::microseconds(50));
  }
  int count = 0;
  MPI_Get_count(&status, type_of<T>(), &count);
  std::vector<T> data(static_cast<std::size_t>(count));
  receive(data.data(), data.size(), from, tag);
  return data;
}

// A result as numbers, in the order of read().
class Numbers {
 public:
  void add(double x) { numbers_.push_back(x); }
  template <class Matrix>
  void add_all(const Matrix& m) {
    add(static_cast<double>(m.rows()));
    add(static_cast<double>(m.cols()));
    numbers_.insert(numbers_.end(), m.data(), m.data() + m.size());
  }

  explicit Numbers(std::vector<double> numbers = {}) : numbers_(std::move(numbers)) {}
  double next() { return numbers_.at(next_++); }
  template <class Matrix>
  void take_all(Matrix& m) {
    const auto rows = static_cast<Eigen::Index>(next());
    const auto cols = static_cast<Eigen::Index>(next());
    m.resize(rows, cols);
    for (double& x : m.reshaped()) x = next();
  }
  const std::vector<double>& all() const { return numbers_; }

 private:
  std::vector<double> numbers_;
  std::size_t next_ = 0;
};

Numbers write(const MonteCarloResult& result) {
  Numbers numbers;
  // Counts below 2^53 are exact in a double.
  numbers.add(static_cast<double>(result.trials));
  numbers.add(result.interrupted ? 1.0 : 0.0);
  numbers.add(result.adaptive ? 1.0 : 0.0);
  numbers.add(result.converged ? 1.0 : 0.0);
  numbers.add(result.coverage_probability);
  numbers.add(static_cast<double>(static_cast<int>(result.interval_method)));
  numbers.add_all(result.mean);
  numbers.add_all(result.standard_deviation);
  numbers.add_all(result.covariance);
  numbers.add_all(result.reached);
  numbers.add(static_cast<double>(result.coverage.size()));
  for (const Coverage& c : result.coverage) {
    for (const double x : {c.symmetric.low, c.symmetric.high, c.shortest.low, c.shortest.high})
      numbers.add(x);
  }
  return numbers;
}

MonteCarloResult read(Numbers numbers, std::string note) {
  MonteCarloResult result;
  result.trials = static_cast<std::uint64_t>(numbers.next());
  result.interrupted = numbers.next() != 0.0;
  result.adaptive = numbers.next() != 0.0;
  result.converged = numbers.next() != 0.0;
  result.coverage_probability = numbers.next();
  result.interval_method = static_cast<IntervalMethod>(static_cast<int>(numbers.next()));
  numbers.take_all(result.mean);
  numbers.take_all(result.standard_deviation);
  numbers.take_all(result.covariance);
  numbers.take_all(result.reached);
  result.coverage.resize(static_cast<std::size_t>(numbers.next()));
  for (Coverage& c : result.coverage) {
    for (double* x : {&c.symmetric.low, &c.symmetric.high, &c.shortest.low, &c.shortest.high})
      *x = numbers.next();
  }
  result.note = std::move(note);
  return result;
}

class MpiTeam final : public MonteCarloTeam {
 public:
  MpiTeam() {
    int provided = 0;
    MPI_Init_thread(nullptr, nullptr, MPI_THREAD_MULTIPLE, &provided);
    MPI_Comm_rank(MPI_COMM_WORLD, &rank_);
    MPI_Comm_size(MPI_COMM_WORLD, &size_);
    if (provided < MPI_THREAD_MULTIPLE) {
      MPI_Finalize();
      throw std::runtime_error(
          "this MPI library does not let several threads send (MPI_THREAD_MULTIPLE), which abcal needs");
    }
  }
  ~MpiTeam() override { MPI_Finalize(); }
  MpiTeam(const MpiTeam&) = delete;
  MpiTeam& operator=(const MpiTeam&) = delete;

  bool leads() const override { return rank_ == kLeader; }
  int rank() const { return rank_; }

  std::vector<TrialBlock> hands(int outputs) override {
    hands_.clear();
    std::vector<TrialBlock> blocks;
    for (int rank = 1; rank < size_; ++rank) {
      std::uint64_t threads = 0;
      receive(&threads, 1, rank, kThreads);
      for (int thread = 0; thread < static_cast<int>(threads); ++thread) {
        const Hand hand{rank, kHand + thread};
        hands_.push_back(hand);
        blocks.push_back([hand, outputs](std::uint64_t first, std::size_t count, double* out) {
          const std::array<std::uint64_t, 2> request{first, count};
          send(request.data(), request.size(), hand.rank, hand.tag);
          receive(out, count * static_cast<std::size_t>(outputs), hand.rank, hand.tag);
        });
      }
    }
    return blocks;
  }

  void dismiss(const MonteCarloResult& result) override { dismiss(write(result), result.note); }
  void dismiss(const std::string& failure) override { dismiss(Numbers(), failure); }

  MonteCarloResult serve(int outputs, const TrialBlock& block, unsigned threads) override {
    const std::uint64_t count = threads != 0 ? threads : std::max(1U, std::thread::hardware_concurrency());
    send(&count, 1, kLeader, kThreads);
    {
      std::vector<std::jthread> workers;
      for (int thread = 0; thread < static_cast<int>(count); ++thread) {
        workers.emplace_back([outputs, &block, tag = kHand + thread] { work(outputs, block, tag); });
      }
    }
    const std::vector<double> numbers = receive_all<double>(kLeader, kResult);
    const std::vector<char> note = receive_all<char>(kLeader, kNote);
    std::string text(note.begin(), note.end());
    if (numbers.empty()) throw std::runtime_error(text);
    return read(Numbers(numbers), std::move(text));
  }

 private:
  struct Hand {
    int rank = 0, tag = 0;
  };

  static void work(int outputs, const TrialBlock& block, int tag) {
    std::vector<double> values;
    while (true) {
      std::array<std::uint64_t, 2> request{};
      receive(request.data(), request.size(), kLeader, tag);
      const auto [first, count] = request;
      if (count == kNoMore) return;
      values.assign(count * static_cast<std::size_t>(outputs), std::numeric_limits<double>::quiet_NaN());
      try {
        block(first, count, values.data());
      } catch (const std::exception& failure) {
        // The leader refuses values that are not finite and names the trial; the reason is logged here.
        print_log("abcal: trials from {}: {}\n", first, failure.what());
        values.assign(values.size(), std::numeric_limits<double>::quiet_NaN());
      }
      send(values.data(), values.size(), kLeader, tag);
    }
  }

  void dismiss(const Numbers& numbers, const std::string& note) {
    for (const Hand& hand : hands_) {
      const std::array<std::uint64_t, 2> request{0, kNoMore};
      send(request.data(), request.size(), hand.rank, hand.tag);
    }
    hands_.clear();
    for (int rank = 1; rank < size_; ++rank) {
      send(numbers.all().data(), numbers.all().size(), rank, kResult);
      send(note.data(), note.size(), rank, kNote);
    }
  }

  int rank_ = 0, size_ = 1;
  std::vector<Hand> hands_;
};

}  // namespace

std::unique_ptr<MonteCarloTeam> mpi_team() {
  // Set by Open MPI's mpirun and srun; a program started by hand pays nothing for MPI.
  if (std::getenv("OMPI_COMM_WORLD_SIZE") == nullptr && std::getenv("PMIX_RANK") == nullptr) return nullptr;
  return std::make_unique<MpiTeam>();
}

void abandon(MonteCarloTeam* team, const char* why, int exit_code) {
  const auto* mpi = dynamic_cast<const MpiTeam*>(team);
  if (mpi == nullptr) return;
  print_log("abcal: process {}: {}\n", mpi->rank(), why);
  MPI_Abort(MPI_COMM_WORLD, exit_code);
}

}  // namespace abcal
