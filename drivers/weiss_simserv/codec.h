#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/wire/frame.h"

/// Languages of Weiss and Voetsch chambers: S!MPAC simserv and ASCII-2. Bytes to requests and back, no port,
/// no clock. Source: docs/protocols/weiss_simserv.md.
namespace abcal::weiss_simserv {

/// Between the parts of a simserv line: one byte, Latin-1.
inline constexpr char kSeparator = '\xB6';
inline constexpr std::size_t kLongestLine = 4096;

/// One line, up to its CR; an LF before it is not part of it.
wire::FrameVerdict check_line(std::string_view bytes);
/// The line without its terminator.
std::string_view line_text(std::string_view frame);

/// "11001<B6>1<B6>1<B6>-40" and CR: a command number, the chamber (always 1) and the arguments.
std::string simserv_request(int number, const std::vector<std::string>& arguments = {});

struct SimservReply {
  int code = 0;  ///< 1: done; negative: refused.
  std::vector<std::string> values;
};
std::optional<SimservReply> parse_simserv(std::string_view line);
std::string_view refusal_text(int code);

/// A number as people and devices write it: "-040.0", "0-40.0", "22.9".
std::optional<double> parse_number(std::string_view text);

/// Layout of the lines of an ASCII-2 chamber, as it reports it ("$01?").
struct Ascii2Layout {
  std::vector<std::string> set_order;    ///< "CV01", "CV02", "SV01", "MV01": the numbers of $01E.
  std::vector<std::string> state_order;  ///< Order in $01I: nominal and actual value have the same name.
  std::size_t channels = 0;              ///< Digital ones.
  std::optional<double> least_set_degc, most_set_degc;  ///< Limits of CV01.
  std::optional<std::size_t> start_channel;
  std::optional<std::size_t> humidity;  ///< Number n of the channel CVnn that is called humidity.
};
std::optional<Ascii2Layout> parse_layout(std::string_view text);

/// The answer to $01I.
struct Ascii2State {
  std::vector<double> numbers;
  std::string channels;  ///< '0' and '1'.
};
std::optional<Ascii2State> parse_state(std::string_view line);

/// The numbers of a name in a state: nominal, then actual.
std::vector<double> values_of(const Ascii2Layout& layout, const Ascii2State& state, std::string_view name);

/// "$01E -040.0 ... 0100" and CR: everything as in `state`, but for CV01 and the channels.
std::string set_command(int address, const Ascii2Layout& layout, const Ascii2State& state, double degc,
                        const std::string& channels);
/// "$01U 0001.0 0000.0 0000.0 0000.0" and CR: K/min up or down; 0: as fast as it can.
std::string slope_command(int address, double up, double down);
std::string plain_command(int address, char what);

}  // namespace abcal::weiss_simserv
