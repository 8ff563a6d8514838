#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/reply_pattern.h"

namespace abcal {

/// Values of named fields: "angle" -> "12.3456".
using FieldValues = std::map<std::string, std::string, std::less<>>;

/// A reply as a description of a stage writes it: text with fields in braces (docs/drivers/described.md).
class ReplyForm {
 public:
  ReplyForm() = default;
  /// @throws std::invalid_argument with the place in words, for a form that cannot be meant
  explicit ReplyForm(std::string text);

  const std::string& text() const { return text_; }
  bool empty() const { return text_.empty(); }
  /// Whether it has the field "angle".
  bool has(std::string_view field) const;
  /// Whether it is a reply for all axes, in which an axis has a place: {before} and {after}.
  bool has_places() const;
  /// The form for the axis at this place, which begins with 1. Every use below requires it of a form with
  /// places.
  ReplyForm at(std::size_t place) const;
  /// The form of the part for one axis, without the others.
  ReplyForm item() const;
  /// The reply for all axes with these parts, one for each place.
  std::string reply_of(const std::vector<std::string>& items) const;

  /// The values of the fields if the whole reply, without its end, is of this form.
  std::optional<FieldValues> match(std::string_view reply) const;
  /// The same replies, for a process that has only a HaltRecipe.
  ReplyPattern pattern() const;
  /// A reply of this form. Fields without a value get an arbitrary one that fits.
  std::string reply(const FieldValues& values) const;

  /// One part. For a value that is used the field is its name; otherwise it is empty.
  struct Part {
    enum class Kind : std::uint8_t {
      kLiteral,   ///< This text.
      kBlanks,    ///< One blank or more.
      kNumber,    ///< A decimal number with sign, point and exponent.
      kRange,     ///< A whole number from `least` to `most`.
      kDigits,    ///< `least` decimal digits; 0: one or more.
      kHex,       ///< `least` hexadecimal digits (0: one to eight) under `mask`.
      kWord,      ///< One character or more, no blank.
      kText,      ///< Anything, also nothing.
      kOneOf,     ///< One of `choices`.
      kBits,      ///< A whole decimal number, perhaps negative, under `mask`.
      kBelow,     ///< A decimal number without an exponent, smaller in size than `text`, 10 to the power
                  ///< -`least`.
      kNotBelow,  ///< Such a number that is not.
      kBefore,    ///< The parts of `least` other axes, ended by `text`; empty: a character each.
      kAfter,     ///< The parts of other axes, begun with `text`; also none.
    };
    enum class Bits : std::uint8_t { kFree, kNoneSet, kSomeSet };

    Kind kind = Kind::kLiteral;
    std::string text{};  ///< For a literal, a limit, or between the parts of axes.
    std::string field{};
    std::vector<std::string>
        choices{};  ///< For kBefore and kAfter the characters of numbers, if they are numbers.
    std::uint32_t least = 0, most = 0;
    std::uint32_t mask = 0;
    Bits bits = Bits::kFree;
  };

 private:
  std::string text_;
  std::vector<Part> parts_;
};

/// A reply that fits both, or nothing if there is none: then no reply can be taken for the other one.
std::optional<std::string> common_reply(const ReplyPattern& one, const ReplyPattern& other);

/// A command as a description writes it: text with fields in braces.
class CommandForm {
 public:
  CommandForm() = default;
  /// @throws std::invalid_argument for a field that no command has, or a number without its decimals
  explicit CommandForm(std::string text);

  const std::string& text() const { return text_; }
  bool empty() const { return text_.empty(); }
  bool has(std::string_view field) const;
  /// Half of the last decimal place with which a number is sent. {angles} is sent as the numbers "angle1" to
  /// "angleN", with blanks between them.
  double half_place(std::string_view field) const;

  /// The command with these values.
  std::string with(const FieldValues& texts, const std::map<std::string, double, std::less<>>& numbers) const;
  /// The values of a command of this form, with `texts` as the only texts that are accepted for a field.
  std::optional<FieldValues> match(std::string_view command,
                                   const std::map<std::string, std::vector<std::string>>& texts) const;

  struct Part {
    std::string text{};   ///< For a literal.
    std::string field{};  ///< Empty: a literal.
    int decimals = 0;
  };

 private:
  std::string text_;
  std::vector<Part> parts_;
};

/// One exchange: a command or a question and its reply; or a command without a reply, and the question that
/// reads back what it has set; or a command without a reply, after which the controller's last error is asked
/// for.
struct DescribedExchange {
  CommandForm send;
  ReplyForm expect;
  CommandForm read_back;  ///< `expect` is the reply to this question, and not to `send`.
  bool silent = false;    ///< It has no reply: the error query acknowledges it.

  bool operator==(const DescribedExchange& other) const {
    return send.text() == other.send.text() && expect.text() == other.expect.text() &&
           read_back.text() == other.read_back.text() && silent == other.silent;
  }
};

/// A reply that is a fault: of a command that is refused, or a state that ends a motion.
struct DescribedFault {
  ReplyForm expect;
  Fault fault = Fault::kRefused;
  std::string says;  ///< In words; empty: the reply itself.
};

/// A stage as its description states it: plain data, from which the driver, the halt recipe and the emulator
/// are made. Angles in degrees.
struct StageDescription {
  std::string maker;
  std::vector<std::string> models;  ///< As the identity gives them; "RT-2*".
  std::string text;                 ///< The whole file.
  std::string sha256;               ///< For the text.
  std::string source;               ///< For messages: its name or path.
  /// Maker, model and serial number of each stage that has passed a trial; empty: any stage.
  std::vector<std::string> tried_with;

  // The line.
  unsigned baud = 9600;
  bool rts_cts = false;
  std::string command_end = "\r";
  bool echoes = false;             ///< Each command comes back in front of its reply.
  std::vector<ReplyForm> ignored;  ///< Lines that answer nothing.
  double gap_s = 0.0;              ///< Least time from a command or a reply to the next command.
  double reply_s = 1.0;            ///< Longest time of a reply.
  ReplyForm last_line;             ///< Ends each reply, whose first line counts; empty: replies are one line.
  std::string address;             ///< Replaces {address} if the bench file states none.

  // The axes.
  std::vector<std::string> axis_names;  ///< That a bench file may use; empty: any.
  double units_per_degree = 1.0;        ///< For angles on the line; the scale, if asked for, replaces it.
  bool scale_in_bench = false;          ///< The bench file states the units of a degree.
  double speed_factor = 1.0;            ///< Speeds on the line are units per second times this.
  bool wraps = false;                   ///< It counts modulo 360 and is sent angles, or
  bool by_increments = false;           ///< increments below half a turn.
  bool always_referenced = false;
  bool referenced_by_hand = false;  ///< A person finds the reference at the controller.
  /// The speed unless one is stated, where each move carries its speed.
  std::optional<double> usual_speed_deg_per_s;

  std::vector<DescribedExchange> identify, prepare, home, move, set_speed, travel, scale;
  DescribedExchange position, status;
  std::optional<DescribedExchange> speed, referenced;
  ReplyForm moving, stopped;
  bool status_of_all = false;  ///< The status is that of the controller: it moves while any axis does.
  /// Farther from the target of a move a status of rest is that before the motion.
  std::optional<double> window_deg;
  std::vector<DescribedFault> status_faults;
  std::vector<ReplyForm> is_referenced, is_not_referenced;
  std::optional<double> lower_deg, upper_deg;

  std::string halt;      ///< Bytes that stop all axes, with their end; may contain {axis} and {address}.
  ReplyForm halt_reply;  ///< To the halt; empty: none. It does not confirm standstill: the status does.
  std::string spoil;     ///< Makes a half-written command one that is refused.
  /// Nothing spoils a half-written command: it is carried out, and the halt follows in the same write.
  bool half_command_executed = false;

  std::vector<DescribedFault> errors;
  /// Takes the last error from a controller whose commands have no reply; `expect` says that there is none.
  std::optional<DescribedExchange> error_query;
  std::vector<DescribedFault> queried_errors;  ///< Its other replies.

  // Only the emulator needs the rest.
  std::string
      emulator_firmware;        ///< Name of a driver whose simulated instrument is used; empty: made of this.
  FieldValues emulator_values;  ///< For text fields: model, firmware.
  std::string emulator_unknown;  ///< Reply to a command that it does not know; empty: none.

  /// The description as it is for one axis: with its place in replies for all axes.
  StageDescription for_axis(const std::string& name) const;
  /// The commands that stop the axes of these names: one for all, or one for each.
  std::vector<std::string> stops(const std::array<std::string, 2>& names,
                                 const std::string& address_of_stage) const;
  bool accepts_model(std::string_view model) const;
  /// Whether the speed of a motion can be chosen.
  bool sets_speed() const { return !set_speed.empty() || usual_speed_deg_per_s; }
};

}  // namespace abcal
