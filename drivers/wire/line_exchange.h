#pragma once

#include <fmt/format.h>

#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "drivers/instrument/clock.h"
#include "drivers/instrument/instrument_error.h"
#include "drivers/instrument/instrument_settings.h"
#include "drivers/instrument/rotation_stage.h"
#include "drivers/wire/haltable_line.h"

namespace abcal::wire {

/// Answer to a query that the controller need not know. Neither value nor error: it stayed silent.
template <class T>
struct LineAnswer {
  std::optional<T> value;
  int error = 0;
};

/// Questions to a controller whose replies name neither their query nor, always, the acceptance of a command:
/// replies come in the order of the queries, and the controller keeps its errors until it is asked.
///
/// A late reply must not be taken for the answer to the next query. Therefore, once a reply is missing or
/// garbled, nothing else is asked before the identity query has been answered, whose answer is known exactly
/// and is unlike any other. Replies before that answer belong to earlier queries.
///
/// A late error must not be taken for the answer to the next command. Therefore an error that the controller
/// may still hold is read before a command is sent, and errors that no command of the owner can have caused
/// (the driver defines them) are not counted.
///
/// All calls require that the line is locked.
class LineExchange {
 public:
  struct Manner {
    std::string identity_request;    ///< Including its terminator.
    std::string_view identity_name;  ///< For messages: "*IDN?".
    std::string error_request;       ///< Including its terminator.
    std::string_view error_name;
    Clock::Duration patience;  ///< For a reply.
    /// Normalises a frame for comparison with the identity; frames that become empty are skipped.
    std::string (*normal)(std::string_view frame);
    std::string (*show)(std::string_view bytes);  ///< Foreign bytes in a message.
  };

  /// `read_errors` asks for the errors that the controller holds, clears them, and returns the first (0:
  /// there was none), by way of ask_error(). `code_of`: the error code in a reply to the error query.
  struct Errors {
    std::function<int(std::string_view after)> read;
    std::function<std::optional<int>(const std::string& frame)> code_of;
  };

  LineExchange(HaltableLine& line, Manner manner, Errors errors)
      : line_(line), manner_(std::move(manner)), errors_(std::move(errors)) {}

  /// The unchanged answer to the identity query. Empty: not known.
  const std::string& identity() const { return identity_; }

  /// Asks for the identity, twice if necessary, until `accept` recognises a reply; otherwise the error quotes
  /// what was received. @throws InstrumentError kNoReply with `if_silent`, kWrongIdentity with `if_foreign`.
  void identify(const std::function<bool(const std::string& frame)>& accept, std::string_view if_silent,
                std::string_view if_foreign, std::size_t most_bytes);

  /// Like identify(), until the same answer has arrived twice in a row: without a checksum on replies, a
  /// damaged identity would never match again. @throws InstrumentError also kBadFrame.
  void identify_twice(const std::function<bool(const std::string& frame)>& accept, std::string_view if_silent,
                      std::string_view if_foreign, std::size_t most_bytes);

  /// Discards received bytes, sends the request, and waits for one reply; absent at the deadline.
  std::optional<std::string> exchange(std::string_view request, Clock::Duration patience);

  /// Asks at most twice. `parse` returns the value of a reply, or nullopt if the reply is not an answer.
  /// @throws InstrumentError kNoReply: the controller is silent altogether; kBadFrame: both were garbled.
  template <class Parse>
  auto ask(const std::string& request, std::string_view shown, Parse parse, Clock::Duration patience) {
    using T = typename std::invoke_result_t<Parse, const std::string&>::value_type;
    for (int attempt = 1;; ++attempt) {
      ensure_in_step(shown);
      std::optional<std::string> reply = exchange(request, patience);
      if (!reply) {
        in_step_ = false;
        reply = resynchronise(shown);
      }
      if (reply) {
        if (auto value = parse(*reply)) return LineAnswer<T>{std::move(value), 0};
        in_step_ = false;
        if (attempt == 2) throw no_answer(*reply, shown);
        continue;
      }
      // The controller is present but did not reply to this query: then the reason is among its errors,
      // unless that error was there before (an unacknowledged halt leaves one).
      const bool was_there = error_may_wait_;
      if (const int code = errors_.read(shown); code != 0 && !was_there)
        return LineAnswer<T>{std::nullopt, code};
      if (attempt == 2) return LineAnswer<T>{};
    }
  }

  /// Asks a question that the controller must know. `refusal` makes the exception from an error code and the
  /// query.
  template <class Parse, class Refusal>
  auto require(const std::string& request, std::string_view shown, Parse parse, Refusal refusal) {
    auto answer = ask(request, shown, parse, manner_.patience);
    if (answer.value) return *std::move(answer.value);
    if (answer.error != 0) throw refusal(answer.error, shown);
    throw line_.failure(
        Fault::kNoReply,
        fmt::format("no answer to \"{}\" within {} s, asked twice, although \"{}\" is answered", shown,
                    to_seconds(manner_.patience), manner_.identity_name));
  }

  /// Sends a set command and the error query in one piece, once, and returns the code. An error that the
  /// controller already holds is read first.
  int execute(std::string_view command, std::string_view shown);

  /// Asks the error query once. A second query would lose the code.
  int ask_error(std::string_view after);

  /// Whether no reply is outstanding: an outstanding one may never arrive.
  bool in_step() const { return in_step_; }

  /// A request was sent whose reply is not awaited: the next query begins with the identity.
  void expect_stray_reply() { in_step_ = identity_.empty(); }

  /// The controller may hold an error that belongs to the past (after a halt, say), or holds none.
  void error_may_wait(bool may) { error_may_wait_ = may; }

 private:
  InstrumentError no_answer(const std::string& reply, std::string_view shown) const;
  std::optional<std::string> take(Clock::Instant deadline);
  std::optional<std::string> resynchronise(std::string_view unanswered);
  void ensure_in_step(std::string_view next) {
    if (!in_step_) resynchronise(next);
  }
  int error_in(std::optional<std::string> reply, std::string_view after);

  HaltableLine& line_;
  const Manner manner_;
  const Errors errors_;
  std::string identity_;  ///< Normal.
  bool in_step_ = true;   ///< False: a reply to an abandoned query may still arrive.
  bool error_may_wait_ = true;
};

/// The calls that a driver of a stage on a line must implement: those of RotationStage, each made with the
/// line locked, and the questions of a halt.
class LineController {
 public:
  LineController(std::string_view what, std::unique_ptr<ByteStream> stream, Clock& clock,
                 HaltableLine::CheckFrame check_frame, HaltableLine::Halting halting)
      : line_(what, std::move(stream), clock, check_frame, std::move(halting)) {}
  virtual ~LineController() = default;
  LineController(const LineController&) = delete;
  LineController& operator=(const LineController&) = delete;

  virtual StageInfo identify() = 0;
  virtual void home(StageAxis axis) = 0;
  virtual void move_to(StageAxis axis, Angle target) = 0;
  /// As RotationStage::set_speed().
  virtual void set_speed(StageAxis axis, std::optional<double> deg_per_s) = 0;
  virtual MotionState motion_state(StageAxis axis) = 0;
  virtual Angle encoder_angle(StageAxis axis) = 0;

  /// Called when a halt begins: the known state of the motion is no longer valid.
  virtual void forget_motion() = 0;
  /// The axes at rest, according to their controllers; an axis that is not on the line counts as at rest. An
  /// axis that has already stopped in this halt (`so_far`) has not been commanded since, and need not be
  /// asked again.
  virtual HaltReport stopped_axes(const HaltReport& so_far) = 0;
  virtual Clock::Duration reply_deadline() const = 0;
  /// Recipes with which another process halts the axes, from the present knowledge: one for each controller
  /// on the line.
  virtual std::vector<HaltRecipe> halt_recipes() const = 0;

  /// Replaces the speed of the settings, and keeps the one before the first replacement.
  /// @param speed  of the settings; absent: the controller's own
  /// @param usual  kept; absent before the first call
  /// @param wanted  absent: the usual one
  /// @param ask  for the controller's own speed
  template <class Ask>
  static void replace_speed(std::optional<double>& speed, std::optional<double>& usual,
                            std::optional<double> wanted, const Ask& ask) {
    if (!usual) usual = speed ? *speed : ask();
    speed = wanted ? wanted : usual;
  }

  HaltableLine& line() { return line_; }
  const HaltableLine& line() const { return line_; }

 protected:
  InstrumentError failure(Fault fault, std::string_view detail) const { return line_.failure(fault, detail); }

  /// Answer of one of several controllers on the line. A controller that is silent counts as "no", so that it
  /// does not hide the answer of the other.
  /// @throws InstrumentError kLinkLost: the line is gone for all of them
  template <class Call>
  static bool says_so(const Call& has_stopped) {
    try {
      return has_stopped();
    } catch (const InstrumentError& error) {
      if (error.fault() == Fault::kLinkLost) throw;
      return false;
    }
  }

 private:
  HaltableLine line_;  ///< Its lock guards the whole state of the driver.
};

/// A stage made of its controller. One owner thread; halt() from any.
class LineStage : public RotationStage {
 private:
  template <class Call>
  auto locked(const Call& call) {
    const std::lock_guard lock(controller_->line());
    return call(*controller_);
  }

 public:
  StageInfo identify() final {
    return locked([](LineController& c) { return c.identify(); });
  }
  void home(StageAxis axis) final {
    locked([&](LineController& c) { c.home(axis); });
  }
  void move_to(StageAxis axis, Angle target) final {
    locked([&](LineController& c) { c.move_to(axis, target); });
  }
  void set_speed(StageAxis axis, std::optional<double> deg_per_s) final {
    locked([&](LineController& c) { c.set_speed(axis, deg_per_s); });
  }
  MotionState motion_state(StageAxis axis) final {
    return locked([&](LineController& c) { return c.motion_state(axis); });
  }
  Angle encoder_angle(StageAxis axis) final {
    return locked([&](LineController& c) { return c.encoder_angle(axis); });
  }
  bool halt() noexcept final { return halt_axes().all_halted(); }
  /// Sends the stop at once, without waiting for an exchange that is under way; then asks until all axes
  /// stand still.
  HaltReport halt_axes() noexcept final {
    HaltReport report;
    controller_->line().halt([this] { controller_->forget_motion(); },
                             [this, &report] {
                               report = controller_->stopped_axes(report);
                               return report.all_halted();
                             });
    return report;
  }
  Clock::Duration reply_deadline() const final { return controller_->reply_deadline(); }
  std::vector<HaltRecipe> halt_recipes() final {
    return locked([](LineController& c) { return c.halt_recipes(); });
  }

 protected:
  explicit LineStage(std::unique_ptr<LineController> controller) : controller_(std::move(controller)) {}

 private:
  std::unique_ptr<LineController> controller_;
};

/// Checks of the settings that every stage driver needs. `maker`: "Newport". `axis_words`: "the number".
/// @throws std::invalid_argument no stream, no axis, one axis twice, a speed that is not a positive number.
void check_stage_settings(std::string_view maker, std::string_view axis_words, const ByteStream* stream,
                          const StageSettings& settings);

}  // namespace abcal::wire
