#include "app/measure/bench/probe.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/text/text.h"
#include "drivers/wire/open_stream.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using std::chrono::milliseconds;

// Listening time before anything is sent; an instrument that streams is recognised within it.
constexpr Clock::Duration kListens = milliseconds(100);
// An instrument that is at rest answers within 100 ms, and a line of 60 characters takes 60 ms at 9600 Bd.
constexpr Clock::Duration kAnswers = milliseconds(300);
// Listening time for instruments that only stream, at least once a second.
constexpr Clock::Duration kStreams = milliseconds(1200);
constexpr std::size_t kMostHeard = 65536;

using AxisNames = decltype(StageSettings::axis_names);

/// A driver of a stage, accelerometer or chamber, reduced to the parts that a probe needs.
struct Candidate {
  std::string name;
  SerialDefaults serial;
  const Recognition* recognition;
  bool stage;
  bool generic;
  std::size_t ports;
  /// Identifies the instrument; `axes` are the axes that a stage is asked for.
  std::function<ProbeAnswer(std::unique_ptr<wire::ByteStream>, Clock&, const AxisNames& axes)> identify;
  /// StageDriver::axes_on_line
  std::function<std::vector<std::string>(std::unique_ptr<wire::ByteStream>, Clock&)> axes_on_line{};
};

ProbeAnswer answer(const std::string& driver, bool stage, const auto& info) {
  return {driver, stage, info.maker, info.model, info.serial_number, info.firmware};
}

std::vector<Candidate> all_candidates() {
  std::vector<Candidate> all;
  for (const StageDriver& driver : stage_drivers()) {
    all.push_back({driver.name, driver.serial, &driver.recognition, true, false, 1,
                   [&driver](std::unique_ptr<wire::ByteStream> stream, Clock& clock, const AxisNames& axes) {
                     std::vector<std::unique_ptr<wire::ByteStream>> streams;
                     streams.push_back(std::move(stream));
                     StageSettings settings;
                     settings.axis_names = axes;
                     return answer(driver.name, true,
                                   driver.make(std::move(streams), clock, settings)->identify());
                   },
                   driver.axes_on_line});
  }
  for (const AccelerometerDriver& driver : accelerometer_drivers()) {
    all.push_back({driver.name, driver.serial, &driver.recognition, false, driver.generic, driver.ports,
                   [&driver](std::unique_ptr<wire::ByteStream> stream, Clock& clock, const AxisNames&) {
                     std::vector<std::unique_ptr<wire::ByteStream>> streams;
                     streams.push_back(std::move(stream));
                     return answer(
                         driver.name, false,
                         driver.make(std::move(streams), clock, AccelerometerSettings{})->identify());
                   }});
  }
  for (const ChamberDriver& driver : chamber_drivers()) {
    all.push_back({driver.name, driver.serial, &driver.recognition, false, false, 1,
                   [&driver](std::unique_ptr<wire::ByteStream> stream, Clock& clock, const AxisNames&) {
                     ChamberSettings settings;
                     settings.tcp_framing = stream->name().starts_with("tcp:");
                     std::vector<std::unique_ptr<wire::ByteStream>> streams;
                     streams.push_back(std::move(stream));
                     ProbeAnswer found = answer(driver.name, false,
                                                driver.make(std::move(streams), clock, settings)->identify());
                     found.chamber = true;
                     return found;
                   }});
  }
  return all;
}

bool same(const SerialDefaults& a, const SerialDefaults& b) {
  return a.baud == b.baud && a.rts_cts == b.rts_cts;
}

/// Whether an error means that the instrument belongs to another driver: it was silent, or did not answer as
/// this driver's instrument does.
bool is_another_instrument(const InstrumentError& error) {
  return error.fault() != Fault::kCannotOpen && error.fault() != Fault::kLinkLost;
}

/// Identity from "MAKER,MODEL,SERIAL,FIRMWARE", for an instrument whose driver needs several ports.
ProbeAnswer from_identity(const Candidate& candidate, std::string_view heard) {
  ProbeAnswer found{candidate.name, candidate.stage, "", "", "", ""};
  found.ports = candidate.ports;
  for (const std::string_view line : pieces::split(heard, '\n')) {
    const std::vector<std::string_view> words = pieces::split(line, ',');
    if (words.size() != 4) continue;
    found.maker = pieces::trimmed(words[0]);
    found.model = pieces::trimmed(words[1]);
    found.serial_number = pieces::trimmed(words[2]);
    found.firmware = pieces::trimmed(words[3]);
    break;
  }
  return found;
}

/// The first printable line of text in the received bytes; empty if no line is.
std::string first_words(std::string_view heard) {
  for (const std::string_view line : pieces::split(heard, '\n')) {
    const std::string_view text = pieces::trimmed(line);
    const bool printable = std::all_of(text.begin(), text.end(), [](char c) { return c >= ' ' && c <= '~'; });
    const bool words = std::any_of(text.begin(), text.end(), [](char c) { return c >= 'A' && c <= 'Z'; });
    if (text.size() >= 4 && printable && words) return wire::printable(text);
  }
  return {};
}

class Probe {
 public:
  Probe(const ProbeOpener& open, Clock& clock, const std::function<void(const std::string&)>& trying)
      : open_(open), clock_(clock), trying_(trying), candidates_(all_candidates()) {}

  std::optional<ProbeAnswer> run() {
    std::string said;
    std::vector<SerialDefaults> done;
    for (const Candidate& first : candidates_) {
      if (!first.recognition->knows || std::any_of(done.begin(), done.end(), [&](const SerialDefaults& one) {
            return same(one, first.serial);
          }))
        continue;
      done.push_back(first.serial);
      const std::string heard = ask(first.serial);
      if (auto found = identified(first.serial, heard)) return found;
      if (said.empty()) said = first_words(heard);
    }
    for (const Candidate& candidate : candidates_) {
      if (candidate.recognition->knows || candidate.ports != 1) continue;
      trying_(candidate.name);
      if (auto found = identify(candidate)) return found;
    }
    if (said.empty()) return std::nullopt;
    ProbeAnswer other;
    other.said = said;
    return other;
  }

 private:
  /// The candidate that recognises the received bytes; null: none. `generic` selects the drivers for any
  /// instrument of a kind, which are tried last.
  const Candidate* knowing(const SerialDefaults& serial, std::string_view heard, bool generic) const {
    const auto found = std::find_if(candidates_.begin(), candidates_.end(), [&](const Candidate& each) {
      return each.generic == generic && same(each.serial, serial) && each.recognition->knows &&
             each.recognition->knows(heard);
    });
    return found == candidates_.end() ? nullptr : &*found;
  }

  /// Listens, and asks each question at these serial settings once, until an instrument is recognised.
  std::string ask(const SerialDefaults& serial) {
    const std::unique_ptr<wire::ByteStream> stream = open_(serial);
    std::string heard;
    const Clock::Instant start = clock_.now();
    const auto listen = [&](Clock::Instant until) {
      while (clock_.now() < until && heard.size() < kMostHeard) {
        heard += stream->read_until(until).bytes;
        if (knowing(serial, heard, false) != nullptr) return true;
      }
      return false;
    };
    if (listen(start + kListens)) return heard;
    std::vector<std::string> asked{""};
    bool streams = false;
    for (const Candidate& candidate : candidates_) {
      if (!same(candidate.serial, serial) || !candidate.recognition->knows) continue;
      const std::string& question = candidate.recognition->question;
      streams = streams || question.empty();
      if (std::find(asked.begin(), asked.end(), question) != asked.end()) continue;
      asked.push_back(question);
      trying_(candidate.name);
      stream->write(question);
      if (listen(clock_.now() + kAnswers)) return heard;
    }
    if (streams) listen(start + kStreams);
    return heard;
  }

  std::optional<ProbeAnswer> identified(const SerialDefaults& serial, const std::string& heard) {
    for (const bool generic : {false, true}) {
      const Candidate* candidate = knowing(serial, heard, generic);
      if (candidate == nullptr) continue;
      if (candidate->ports != 1) return from_identity(*candidate, heard);
      if (auto found = identify(*candidate)) return found;
    }
    return std::nullopt;
  }

  std::optional<ProbeAnswer> identify(const Candidate& candidate) {
    const std::vector<std::string> found = axes_on_line(candidate);
    // A stage's controller may have one axis only.
    AxisNames names = StageSettings{}.axis_names;
    for (std::size_t k = 0; k < names.size() && !found.empty(); ++k)
      names[k] = k < found.size() ? found[k] : "";
    for (const AxisNames& axes : {names, AxisNames{names[0], ""}}) {
      try {
        ProbeAnswer answer = candidate.identify(open_(candidate.serial), clock_, axes);
        answer.axes = found;
        return answer;
      } catch (const InstrumentError& error) {
        if (!is_another_instrument(error)) throw;
        if (!candidate.stage || !candidate.recognition->knows || error.fault() != Fault::kWrongIdentity)
          break;
      }
    }
    return std::nullopt;
  }

  std::vector<std::string> axes_on_line(const Candidate& candidate) {
    if (!candidate.axes_on_line) return {};
    try {
      return candidate.axes_on_line(open_(candidate.serial), clock_);
    } catch (const InstrumentError& error) {
      if (!is_another_instrument(error)) throw;
      return {};
    }
  }

  const ProbeOpener& open_;
  Clock& clock_;
  const std::function<void(const std::string&)>& trying_;
  std::vector<Candidate> candidates_;
};

}  // namespace

std::optional<ProbeAnswer> probe_port(const ProbeOpener& open, Clock& clock,
                                      const std::function<void(const std::string&)>& trying) {
  return Probe(open, clock, trying).run();
}

std::optional<ProbeAnswer> probe_port(const std::string& port, Clock& clock,
                                      const std::function<void(const std::string&)>& trying) {
  const ProbeOpener open = [&](const SerialDefaults& serial) {
    wire::SerialSettings settings;
    settings.baud = serial.baud;
    settings.rts_cts = serial.rts_cts;
    return wire::open_stream(port, settings, clock);
  };
  return probe_port(open, clock, trying);
}

}  // namespace abcal
