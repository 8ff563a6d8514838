#include "drivers/iio/accelerometer.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/number.h"

namespace abcal::iio {
namespace {

using namespace std::string_view_literals;

constexpr std::array<std::string_view, 3> kAxes{"accel_x", "accel_y", "accel_z"};
constexpr double kRateTolerance = 0.01;
constexpr double kBlockSeconds = 0.02;
constexpr int kBlocksInKernel = 128;
constexpr int kMostLostInARow = 3;
constexpr std::size_t kExaminedPeriods = 9;
constexpr double kPeriodTolerance = 0.2;  // Fraction of the median period: timer triggers jitter.

std::optional<double> number_in(std::string_view text) {
  const auto value = pieces::number<double>(text);
  return value && std::isfinite(*value) ? value : std::nullopt;
}

}  // namespace

IioAccelerometer::IioAccelerometer(std::unique_ptr<wire::ByteStream> stream, Clock& clock,
                                   const AccelerometerSettings& settings)
    : stream_(stream ? std::move(stream) : throw std::invalid_argument("accelerometer iio: no stream")),
      clock_(clock),
      settings_(settings),
      session_(*stream_, clock_) {
  if (settings_.rate_hz > 0.0 && std::isfinite(settings_.rate_hz)) return;
  throw std::invalid_argument(
      fmt::format("accelerometer iio: rate_hz is {}; required: a positive number", settings_.rate_hz));
}

void IioAccelerometer::end_and_fail(Fault fault, std::string_view detail) {
  running_ = false;
  readings_.close();
  session_.fail(fault, detail);
}

/// The only device with three axes in its scans, or the one that the bench file names.
std::size_t IioAccelerometer::choose_device() const {
  std::vector<std::string> found;
  std::optional<std::size_t> chosen;
  for (std::size_t n = 0; n < context_.devices.size(); ++n) {
    const Device& one = context_.devices[n];
    if (!lay_out(one)) continue;
    found.push_back(fmt::format("{} ({})", one.name, one.id));
    if (settings_.names.empty() || settings_.names == one.name || settings_.names == one.id) {
      if (chosen)
        session_.fail(
            Fault::kWrongIdentity,
            fmt::format(
                "there are several accelerometers: {}; required: names = the name or the id of one of them",
                fmt::join(found, ", ")));
      chosen = n;
    }
  }
  if (chosen) return *chosen;
  session_.fail(Fault::kWrongIdentity,
                found.empty()
                    ? fmt::format("none of its {} devices has accel_x, accel_y and accel_z in its buffer; "
                                  "required: an accelerometer whose driver has a buffer (scan_elements)",
                                  context_.devices.size())
                    : fmt::format("it has no accelerometer \"{}\"; it has: {}", settings_.names,
                                  fmt::join(found, ", ")));
}

/// Value of an attribute of a channel, or of the device if `channel` is empty. @throws InstrumentError
/// kRefused.
std::string IioAccelerometer::attribute(std::string_view channel, std::string_view name) {
  const std::string command = channel.empty()
                                  ? fmt::format("READ {} {}", device().id, name)
                                  : fmt::format("READ {} INPUT {} {}", device().id, channel, name);
  std::int64_t error = 0;
  auto text = session_.text(command, &error);
  if (!text) session_.refuse(command, error);
  return *std::move(text);
}

double IioAccelerometer::number_of_attribute(std::string_view channel, std::string_view name) {
  const std::string text = attribute(channel, name);
  const auto value = number_in(text);
  if (!value)
    session_.fail(Fault::kBadFrame, fmt::format("{} {} is \"{}\"; required: a number", channel, name, text));
  return *value;
}

std::optional<std::string> IioAccelerometer::debug_text(std::string_view name) {
  if (!device().has_debug(name)) return std::nullopt;
  return session_.text(fmt::format("READ {} DEBUG {}", device().id, name));
}

void IioAccelerometer::read_scales() {
  for (std::size_t j = 0; j < 3; ++j) {
    const Channel& channel = *device().find(kAxes[j]);
    scale_[j] = channel.has("scale") ? number_of_attribute(kAxes[j], "scale") : 1.0;
    offset_[j] = channel.has("offset") ? number_of_attribute(kAxes[j], "offset") : 0.0;
  }
}

AccelerometerInfo IioAccelerometer::identify() {
  running_ = false;
  readings_.close();
  const std::string version = session_.greet();
  const auto xml = session_.text("PRINT");
  auto context = xml ? parse_context(*xml) : std::nullopt;
  if (!context) session_.fail(Fault::kBadFrame, "\"PRINT\" was not answered with a description of devices");
  context_ = *std::move(context);
  chosen_ = choose_device();
  layout_ = *lay_out(device());
  close_buffer();  // An earlier connection that was lost may have left it open.
  const std::string serial_number = debug_text("serial_number").value_or("");
  const std::string revision = debug_text("firmware_revision").value_or("");
  const std::string model = device().name.empty() ? device().id : device().name;
  session_.rename(fmt::format("accelerometer iio {}{} on {}", model,
                              serial_number.empty() ? "" : fmt::format(" (SN {})", serial_number),
                              stream_->name()));
  read_scales();
  double full_scale = 0.0;
  for (std::size_t j = 0; j < 3; ++j)
    full_scale = std::max(
        full_scale, std::abs(scale_[j]) * std::ldexp(1.0, static_cast<int>(layout_.axes[j].format.bits) - 1));
  return AccelerometerInfo{
      .maker = "Linux IIO",
      .model = model,
      .serial_number = serial_number,
      .firmware = revision.empty() ? "iiod " + version : fmt::format("{} (iiod {})", revision, version),
      .output_unit = "m/s2",
      .full_scale = settings_.full_scale.value_or(full_scale),
      .resolution = std::abs(*std::max_element(scale_.begin(), scale_.end(),
                                               [](double a, double b) { return std::abs(a) < std::abs(b); })),
      .rate_hz = settings_.rate_hz,
  };
}

std::map<std::string, std::string> IioAccelerometer::correction_registers() {
  std::map<std::string, std::string> registers;
  for (const std::string_view axis : kAxes)
    for (const std::string_view name : {"calibbias", "calibscale"})
      if (device().find(axis)->has(name)) registers[fmt::format("{} {}", axis, name)] = attribute(axis, name);
  return registers;
}

namespace {

std::string name_of(std::string_view axis, std::string_view attribute) {
  return fmt::format("{} {}", axis, attribute);
}

/// "0.5": a number of a unit; "5": of counts.
bool has_point(const RegisterTexts& registers, const std::string& name) {
  const auto found = registers.find(name);
  return found != registers.end() && found->second.find('.') != std::string::npos;
}

constexpr double kMicro = 1e-6;                   // Fractions have at least six digits.
constexpr double kAdisScaleStep = 1.0 / 32768.0;  // One unit of the whole-number calibscale of an ADIS part.
constexpr double kAdisLargest = 32767.0;

}  // namespace

/// Change of the scale per unit of calibscale; 0 if the meaning of a whole number is not known.
double IioAccelerometer::calibscale_step(const RegisterTexts& registers, std::string_view axis) const {
  if (has_point(registers, name_of(axis, "calibscale"))) return kMicro;
  return device().name.starts_with("adis") ? kAdisScaleStep : 0.0;
}

/// calibscale as a factor, 1 if absent.
double IioAccelerometer::scale_of(const RegisterTexts& registers, std::string_view axis) const {
  const std::string name = name_of(axis, "calibscale");
  if (!registers.contains(name)) return 1.0;
  const double value = register_number(registers, name);
  const double step = calibscale_step(registers, axis);
  if (step == kMicro && value > 0.0) return value;
  if (step == kAdisScaleStep) return 1.0 + value * step;
  throw std::invalid_argument(
      fmt::format("{} is {}; required: a factor above 0 with a decimal point, or the whole number of an ADIS "
                  "part: what another means is not known",
                  name, registers.at(name)));
}

CorrectionAbility IioAccelerometer::ability() {
  const RegisterTexts now = correction_registers();
  CorrectionAbility ability{.shape = CorrectionShape::kDiagonal,
                            .rule =
                                "output = scale (calibscale raw + calibbias); a calibbias with a decimal "
                                "point in m/s2, a whole one in counts",
                            .can_save = false};
  for (std::size_t j = 0; j < 3; ++j) {
    const std::string bias = name_of(kAxes[j], "calibbias");
    if (!now.contains(bias))
      session_.fail(Fault::kRefused, fmt::format("it has no {}: nothing that could be written", bias));
    ability.offset_step = std::max(ability.offset_step, has_point(now, bias) ? kMicro : std::abs(scale_[j]));
    if (!now.contains(name_of(kAxes[j], "calibscale"))) ability.shape = CorrectionShape::kOffset;
    ability.matrix_step = std::max(ability.matrix_step, calibscale_step(now, kAxes[j]));
  }
  if (ability.shape == CorrectionShape::kOffset) ability.matrix_step = 0.0;
  return ability;
}

OutputCorrection IioAccelerometer::decode(const RegisterTexts& registers) {
  OutputCorrection correction;
  for (std::size_t n = 0; n < 3; ++n) {
    const auto j = static_cast<Eigen::Index>(n);
    const std::string bias = name_of(kAxes[n], "calibbias");
    const double factor = scale_of(registers, kAxes[n]);
    const double unit = has_point(registers, bias) ? 1.0 : scale_[n];
    correction.matrix(j, j) = factor;
    correction.offset[j] = -register_number(registers, bias) * unit / factor;
  }
  return correction;
}

RegisterTexts IioAccelerometer::encode(const OutputCorrection& wanted, const RegisterTexts& now) {
  RegisterTexts registers = now;
  for (std::size_t n = 0; n < 3; ++n) {
    const auto j = static_cast<Eigen::Index>(n);
    const std::string scale = name_of(kAxes[n], "calibscale");
    if (now.contains(scale)) {
      const double factor = wanted.matrix(j, j);
      const bool whole = calibscale_step(now, kAxes[n]) == kAdisScaleStep;
      if (!(factor > 0.0) || (whole && std::abs(factor - 1.0) > kAdisLargest * kAdisScaleStep))
        throw std::invalid_argument(
            fmt::format("{}: the factor would be {:.6g}; it does not hold this", scale, factor));
      registers[scale] =
          whole ? fmt::format("{:.0f}", (factor - 1.0) / kAdisScaleStep) : fmt::format("{:.6f}", factor);
    }
    const std::string bias = name_of(kAxes[n], "calibbias");
    const double mps2 = -wanted.offset[j] * scale_of(registers, kAxes[n]);
    registers[bias] =
        has_point(now, bias) ? fmt::format("{:.6f}", mps2) : fmt::format("{:.0f}", mps2 / scale_[n]);
  }
  return registers;
}

void IioAccelerometer::write(const RegisterTexts& registers) {
  for (const std::string_view axis : kAxes) {
    for (const std::string_view name : {"calibscale", "calibbias"}) {
      const auto found = registers.find(name_of(axis, name));
      if (found == registers.end()) continue;
      const std::string value = found->second + '\0';  // libiio also ends values with a NUL.
      const std::string command =
          fmt::format("WRITE {} INPUT {} {} {}", device().id, axis, name, value.size());
      if (const std::int64_t error = session_.number(command, value); error < 0)
        session_.refuse(fmt::format("{} ({})", command, found->second), error);
    }
  }
}

void IioAccelerometer::save(const RegisterTexts&) {
  session_.fail(Fault::kRefused,
                "Industrial I/O has no attribute that keeps calibbias and calibscale when it is switched "
                "off; required: no --save, and a start script of that machine that writes them");
}

void IioAccelerometer::set_rate() {
  constexpr std::string_view kName = "sampling_frequency";
  const bool of_device = device().has(kName);
  if (!of_device && !device().find(kAxes[0])->has(kName)) return;  // Its trigger has it.
  const std::string_view channel = of_device ? std::string_view() : kAxes[0];
  // With a zero at the end, as libiio writes values.
  const std::string value = fmt::format("{:.9g}", settings_.rate_hz) + '\0';
  const std::string command =
      of_device ? fmt::format("WRITE {} {} {}", device().id, kName, value.size())
                : fmt::format("WRITE {} INPUT {} {} {}", device().id, channel, kName, value.size());
  const std::int64_t error = session_.number(command, value);
  const double rate_hz = error < 0 ? 0.0 : number_of_attribute(channel, kName);
  if (std::abs(rate_hz - settings_.rate_hz) <= kRateTolerance * settings_.rate_hz) return;
  const std::string available = std::string(kName) + "_available";
  const bool lists = of_device ? device().has(available) : device().find(channel)->has(available);
  const std::string advice =
      lists ? fmt::format("; it has {}", attribute(channel, available)) : std::string();
  if (error < 0) session_.refuse(fmt::format("{} ({:.9g})", command, settings_.rate_hz), error, advice);
  session_.fail(Fault::kRefused, fmt::format("rate_hz is {}; the device set {:.6g} instead{}",
                                             settings_.rate_hz, rate_hz, advice));
}

/// If it has none, that of the device itself, as most drivers of the kernel make one. A server that refuses
/// the question knows no triggers: the device samples without one.
void IioAccelerometer::set_trigger() {
  constexpr std::int64_t kNoEntry = -2;    // ENOENT of Linux
  constexpr std::int64_t kNoDevice = -19;  // ENODEV
  const auto current = session_.text(fmt::format("GETTRIG {}", device().id), nullptr, ReplyKind::kName);
  if (!current || !current->empty()) return;
  for (const Device& one : context_.devices) {
    if (!one.id.starts_with("trigger") || !one.name.starts_with(device().name + "-dev")) continue;
    const std::string command = fmt::format("SETTRIG {} {}", device().id, one.id);
    const std::int64_t error = session_.number(command);
    if (error < 0 && error != kNoEntry && error != kNoDevice) session_.refuse(command, error);
    return;
  }
}

void IioAccelerometer::close_buffer() {
  constexpr int kMostOpened = 3;  // OPEN whose reply was missing.
  for (int n = 0; n < kMostOpened; ++n)
    if (session_.number(fmt::format("CLOSE {}", device().id)) < 0) break;
  perhaps_open_ = false;
}

void IioAccelerometer::open_buffer() {
  if (perhaps_open_) close_buffer();
  // Servers that buffer in another way refuse this.
  session_.number(fmt::format("SET {} BUFFERS_COUNT {}", device().id, kBlocksInKernel));
  const std::string command = fmt::format("OPEN {} {} {}", device().id, block_scans_, layout_.mask);
  perhaps_open_ = true;
  if (const std::int64_t error = session_.number(command, {}, false); error < 0) {
    perhaps_open_ = false;
    session_.refuse(
        command, error,
        ": does another program use the buffer, and has the device a trigger (trigger/current_trigger)?");
  }
}

void IioAccelerometer::start() {
  identify();
  set_rate();
  set_trigger();
  if (device().has("current_timestamp_clock"))
    session_.number(fmt::format("WRITE {} current_timestamp_clock 10", device().id), "monotonic\0"sv);
  block_scans_ = static_cast<std::size_t>(std::max(1.0, std::round(settings_.rate_hz * kBlockSeconds)));
  // The server's default time limit of 1 s is too short for slow rates. It must not exceed ours, either, or
  // we would not learn of a missing block.
  session_.number(
      fmt::format("TIMEOUT {:.0f}", 1500.0 + 1000.0 * static_cast<double>(block_scans_) / settings_.rate_hz));
  open_buffer();
  readings_.restart();
  bad_blocks_ = 0;
  lost_in_a_row_ = 0;
  skipped_at_start_ = session_.skipped_bytes();
  last_time_ns_.reset();
  periods_s_.clear();
  running_ = true;
}

std::optional<Reading> IioAccelerometer::next(Clock::Instant deadline) {
  if (!running_) session_.fail(Fault::kNotReady, "asked for a reading before it was started");
  for (;;) {
    if (auto reading = readings_.pop()) return reading;
    const std::size_t wanted = block_scans_ * layout_.size;
    if (!session_.block_under_way())
      session_.begin_block(fmt::format("READBUF {} {}", device().id, wanted), wanted, layout_.mask,
                           from_seconds(static_cast<double>(block_scans_) / settings_.rate_hz));
    Samples samples;
    const Session::BlockEnd end = session_.await_block(deadline, samples);
    if (end == Session::BlockEnd::kNotYet) return std::nullopt;
    if (end == Session::BlockEnd::kComplete) {
      take_block(samples);
      continue;
    }
    ++bad_blocks_;
    if (++lost_in_a_row_ >= kMostLostInARow)
      end_and_fail(end == Session::BlockEnd::kDamaged ? Fault::kBadFrame : Fault::kNoReply,
                   fmt::format("{} blocks of samples in a row did not come or were damaged", lost_in_a_row_));
    if (clock_.now() >= deadline) return std::nullopt;
  }
}

void IioAccelerometer::take_block(const Samples& samples) {
  lost_in_a_row_ = 0;
  for (std::size_t at = 0; at + layout_.size <= samples.bytes.size(); at += layout_.size)
    take_scan(std::string_view(samples.bytes).substr(at, layout_.size));
  if (samples.bytes.size() == block_scans_ * layout_.size) return;
  constexpr std::int64_t kTimedOut = -110;
  end_and_fail(samples.error == kTimedOut ? Fault::kNoReply : Fault::kNotReady,
               fmt::format("the buffer gave error {} instead of samples: does the trigger of the device run, "
                           "and is the device still there?",
                           samples.error));
}

void IioAccelerometer::take_scan(std::string_view scan) {
  Reading reading;
  for (std::size_t j = 0; j < 3; ++j) {
    const Raw raw = value_at(scan, layout_.axes[j]);
    reading.output(static_cast<Eigen::Index>(j)) = (static_cast<double>(raw.value) + offset_[j]) * scale_[j];
    reading.over_range = reading.over_range || raw.at_end;
  }
  reading.arrival = session_.last_arrival();
  readings_.push(std::move(reading),
                 layout_.timestamp ? steps_to(value_at(scan, *layout_.timestamp).value) : 1);
}

/// How many samples were made since the last one, by the device's time.
std::uint64_t IioAccelerometer::steps_to(std::int64_t time_ns) {
  const auto last = std::exchange(last_time_ns_, time_ns);
  if (!last) return 1;
  if (time_ns <= *last)
    end_and_fail(Fault::kNotReady,
                 fmt::format("its time went from {} to {} ns: its clock was set, or it was restarted", *last,
                             time_ns));
  const double period_s = 1e-9 * (static_cast<double>(time_ns) - static_cast<double>(*last));
  if (periods_s_.size() < kExaminedPeriods) {
    periods_s_.push_back(period_s);
    if (periods_s_.size() == kExaminedPeriods) {
      auto sorted = periods_s_;
      std::sort(sorted.begin(), sorted.end());
      const double median_s = sorted[kExaminedPeriods / 2];
      if (std::abs(median_s * settings_.rate_hz - 1.0) > kPeriodTolerance)
        end_and_fail(Fault::kImplausible,
                     fmt::format("its samples are {:.4g} s apart, but rate_hz = {} means {:.4g} s: set the "
                                 "rate of its trigger, or rate_hz",
                                 median_s, settings_.rate_hz, 1.0 / settings_.rate_hz));
    }
  }
  return static_cast<std::uint64_t>(std::max(1.0, std::round(period_s * settings_.rate_hz)));
}

/// Waits for the block under way and drops it.
void IioAccelerometer::end_block() {
  Samples samples;
  while (session_.block_under_way()) session_.await_block(Clock::Instant::max(), samples);
}

void IioAccelerometer::discard_pending() {
  if (!running_) return;
  end_block();
  open_buffer();
  readings_.begin_discard();
  readings_.end_discard(false, false);
  last_time_ns_.reset();
}

StreamHealth IioAccelerometer::health() const {
  return {.readings = readings_.readings(),
          .lost_readings = readings_.lost(),
          .bad_frames = bad_blocks_,
          .skipped_bytes = session_.skipped_bytes() - skipped_at_start_};
}

void IioAccelerometer::stop() noexcept {
  try {
    end_block();
    if (perhaps_open_) close_buffer();
  } catch (...) {
    // On the way out: by the interface, failure is not reported.
  }
  running_ = false;
  readings_.close();
}

}  // namespace abcal::iio
