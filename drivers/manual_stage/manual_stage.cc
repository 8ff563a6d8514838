#include "drivers/manual_stage/manual_stage.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <istream>
#include <ostream>
#include <sstream>
#include <stdexcept>
#include <streambuf>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"
#include "drivers/text/text.h"

namespace abcal::manual_stage {
namespace {

constexpr std::string_view kWho = "manual stage";

/// Scales turn without end; ten turns are more than any plan asks for.
constexpr double kTravelDeg = 3600.0;

using pieces::trimmed;

std::optional<double> number_in(std::string_view text) {
  const auto value = pieces::number<double>(text, std::chars_format::fixed);
  return value && std::isfinite(*value) ? value : std::nullopt;
}

InstrumentError failure(Fault fault, std::string_view detail) {
  return {kWho, fault, detail};
}

/// A pipe that wakes a reader.
class WakePipe {
 public:
  WakePipe() {
    if (::pipe2(ends_.data(), O_CLOEXEC | O_NONBLOCK) != 0)
      throw failure(Fault::kCannotOpen, "the system gave no pipe");
  }
  ~WakePipe() {
    ::close(ends_[0]);
    ::close(ends_[1]);
  }
  WakePipe(const WakePipe&) = delete;
  WakePipe& operator=(const WakePipe&) = delete;

  int to_poll() const { return ends_[0]; }
  void wake() const {
    const char byte = 0;
    // A full pipe has woken the reader already.
    if (::write(ends_[1], &byte, 1) != 1) return;
  }
  void drain() const {
    std::array<char, 64> bytes{};
    while (::read(ends_[0], bytes.data(), bytes.size()) > 0) continue;
  }

 private:
  std::array<int, 2> ends_{-1, -1};
};

/// Standard input, whose reads end with end of file once the pipe is written to.
class TerminalInput final : public std::streambuf {
 public:
  explicit TerminalInput(const WakePipe& pipe) : pipe_(pipe) {}

 protected:
  int_type underflow() override {
    for (;;) {
      std::array<pollfd, 2> waiting{pollfd{STDIN_FILENO, POLLIN, 0}, pollfd{pipe_.to_poll(), POLLIN, 0}};
      if (::poll(waiting.data(), waiting.size(), -1) < 0) {
        if (errno == EINTR) continue;
        return traits_type::eof();
      }
      if (waiting[1].revents != 0) return traits_type::eof();
      const ssize_t count = ::read(STDIN_FILENO, buffer_.data(), buffer_.size());
      if (count < 0 && errno == EINTR) continue;
      if (count <= 0) return traits_type::eof();
      setg(buffer_.data(), buffer_.data(), buffer_.data() + count);
      return traits_type::to_int_type(buffer_[0]);
    }
  }

 private:
  const WakePipe& pipe_;
  std::array<char, 512> buffer_{};
};

/// Passes the written text on at each flush.
class ShownOutput final : public std::stringbuf {
 public:
  explicit ShownOutput(std::function<void(std::string_view)> show) : show_(std::move(show)) {}

 protected:
  int sync() override {
    show_(str());
    str({});
    return 0;
  }

 private:
  std::function<void(std::string_view)> show_;
};

/// A ManualStage with the input it reads and the output it writes.
class TerminalStage final : public RotationStage {
 public:
  TerminalStage(const StageSettings& settings, std::function<void(std::string_view)> show)
      : buffer_(pipe_),
        in_(&buffer_),
        shown_(std::move(show)),
        out_(&shown_),
        stage_(in_, out_, settings, [this] { pipe_.wake(); }) {}

  StageInfo identify() override {
    pipe_.drain();
    in_.clear();
    return stage_.identify();
  }
  void home(StageAxis axis) override { stage_.home(axis); }
  void move_to(StageAxis axis, Angle target) override { stage_.move_to(axis, target); }
  MotionState motion_state(StageAxis axis) override { return stage_.motion_state(axis); }
  Angle encoder_angle(StageAxis axis) override { return stage_.encoder_angle(axis); }
  bool halt() noexcept override { return stage_.halt(); }

 private:
  WakePipe pipe_;
  TerminalInput buffer_;
  std::istream in_;
  ShownOutput shown_;
  std::ostream out_;
  ManualStage stage_;
};

}  // namespace

std::optional<Angle> parse_typed_angle(std::string_view text) {
  std::string plain(trimmed(text));
  for (char& c : plain)
    if (c == ',') c = '.';
  std::string_view rest = plain;
  double sign = 1.0;
  if (rest.starts_with('-') || rest.starts_with('+')) {
    if (rest.starts_with('-')) sign = -1.0;
    rest.remove_prefix(1);
  }
  std::vector<double> parts;
  while (!rest.empty()) {
    const std::size_t blank = rest.find_first_of(" \t");
    const std::string_view word = rest.substr(0, blank);
    const auto value = number_in(word);
    if (!value || *value < 0.0 || std::signbit(*value) || parts.size() == 3) return std::nullopt;
    if (!parts.empty() && (*value >= 60.0 || parts.back() != std::floor(parts.back()))) return std::nullopt;
    parts.push_back(*value);
    rest = blank == std::string_view::npos ? std::string_view() : trimmed(rest.substr(blank));
  }
  if (parts.empty()) return std::nullopt;
  double degrees = parts[0];
  if (parts.size() > 1) degrees += parts[1] / 60.0;
  if (parts.size() > 2) degrees += parts[2] / 3600.0;
  return Angle::degrees(sign * degrees);
}

ManualStage::ManualStage(std::istream& in, std::ostream& out, const StageSettings& settings,
                         std::function<void()> wake)
    : in_(in), out_(out), settings_(settings), wake_(std::move(wake)) {
  if (settings.axis_names[0].empty() && settings.axis_names[1].empty())
    throw std::invalid_argument("manual stage: no axis is named; required: a name for X, Z or both");
  if (settings.speed_deg_per_s[0] || settings.speed_deg_per_s[1])
    throw std::invalid_argument(
        "manual stage: found a speed; required: none, because a person turns the stage");
  if (!settings.address.empty())
    throw std::invalid_argument(
        "manual stage: found an address; required: none, because there is no controller");
}

StageInfo ManualStage::identify() {
  halted_ = false;  // identify() begins a new use of the stage.
  StageInfo info;
  info.maker = "none";
  info.model = kWho;
  for (const StageAxis axis : kStageAxes) {
    if (settings_.axis_names[index(axis)].empty()) continue;
    StageAxisInfo& told = info.axes[index(axis)];
    told.stage_name = settings_.axis_names[index(axis)];
    told.travel_min = Angle::degrees(-kTravelDeg);
    told.travel_max = Angle::degrees(kTravelDeg);
    told.referenced = referenced_[index(axis)];
  }
  return info;
}

std::string ManualStage::name_of(StageAxis axis) const {
  const std::string& name = settings_.axis_names[index(axis)];
  if (name.empty())
    throw failure(Fault::kNotReady,
                  fmt::format("axis {} is not turned by hand on this bench", to_string(axis)));
  return fmt::format("{} axis (\"{}\")", axis == StageAxis::kX ? "X, the outer, horizontal" : "Z, the inner",
                     name);
}

std::string ManualStage::read_line() {
  std::string line;
  const bool read = !halted_ && static_cast<bool>(std::getline(in_, line));
  if (halted_) {
    out_ << std::endl;
    throw failure(Fault::kNotReady, "the question was ended by a halt; the angle of the axis is unknown");
  }
  if (!read) throw failure(Fault::kLinkLost, "the input has ended, so nobody can confirm the angle");
  return line;
}

Angle ManualStage::ask(StageAxis axis, const std::string& question, Angle expected) {
  known_angle_[index(axis)].reset();  // From here on it may be turned.
  out_ << question << " Press Enter when it is there, or type the angle that the scale shows: " << std::flush;
  for (;;) {
    const std::string line = read_line();
    if (trimmed(line).empty()) {
      known_angle_[index(axis)] = expected;
      return expected;
    }
    const auto angle = parse_typed_angle(line);
    if (angle && std::abs((*angle - expected).deg()) <= kPlausibleDeg) {
      known_angle_[index(axis)] = angle;
      return *angle;
    }
    if (angle) {
      out_ << fmt::format(
                  "{} deg differs by more than {} deg from {} deg. Turn it there, then press Enter or type "
                  "the angle: ",
                  angle->deg(), kPlausibleDeg, expected.deg())
           << std::flush;
    } else {
      out_ << fmt::format("\"{}\" is not an angle; press Enter, or type for example 89.98 or 89 58 48: ",
                          trimmed(line))
           << std::flush;
    }
  }
}

void ManualStage::home(StageAxis axis) {
  const std::string name = name_of(axis);
  referenced_[index(axis)] = false;
  ask(axis, fmt::format("Set the {} to 0 of its scale.", name), Angle());
  referenced_[index(axis)] = true;
}

void ManualStage::move_to(StageAxis axis, Angle target) {
  const std::string name = name_of(axis);
  if (!std::isfinite(target.deg()))
    throw failure(Fault::kOutOfTravel,
                  fmt::format("target {} of the {} is not a number", target.deg(), name));
  if (!referenced_[index(axis)])
    throw failure(Fault::kNotReady, fmt::format("the {} has not been set to 0 of its scale yet", name));
  ask(axis, fmt::format("Turn the {} to {:.4f} deg.", name, target.deg() + 0.0), target);
}

MotionState ManualStage::motion_state(StageAxis axis) {
  encoder_angle(axis);
  return MotionState::kStopped;
}

Angle ManualStage::encoder_angle(StageAxis axis) {
  const std::string name = name_of(axis);
  if (!known_angle_[index(axis)])
    throw failure(Fault::kNotReady, fmt::format("the angle of the {} has not been confirmed", name));
  return *known_angle_[index(axis)];
}

bool ManualStage::halt() noexcept {
  halted_ = true;
  try {
    if (wake_) wake_();
  } catch (...) {  // The question then ends with the next line typed.
  }
  return false;
}

std::unique_ptr<RotationStage> at_terminal(const StageSettings& settings,
                                           std::function<void(std::string_view)> show) {
  if (::isatty(STDIN_FILENO) != 1 || ::isatty(STDERR_FILENO) != 1) {
    throw failure(Fault::kCannotOpen,
                  "a stage that is turned by hand needs a person at a terminal, but standard input or "
                  "standard error is not a terminal");
  }
  return std::make_unique<TerminalStage>(settings, std::move(show));
}

}  // namespace abcal::manual_stage
