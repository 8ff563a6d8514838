#include "app/bench_file/stage_description_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <toml++/toml.h>
#include <algorithm>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/formats/toml_reader.h"
#include "drivers/instrument/driver_catalogue.h"
#include "protocol/record/sha256.h"

namespace abcal {
namespace {

constexpr const char* kKind = "a description of a stage; docs/drivers/described.md shows one";
constexpr const char* kSchema = "abcal.stage/1";

/// A form and its place in the file, for checks between sections.
struct PlacedForm {
  ReplyForm form;
  std::uint32_t line = 0;
  std::string where;
};

/// Reads one description. All that is wrong is reported to the reader.
class DescriptionReader {
 public:
  DescriptionReader(TomlReader& reader, StageDescription& out) : reader_(reader), out_(out) {}

  void read() {
    read_top();
    read_transport();
    read_axes();
    read_identity();
    read_motion();
    read_state();
    read_halt();
    read_errors();
    read_error_query();
    read_emulator();
    check_scale();
    check_wrap();
    check_axes();
    check_places();
    check_replies();
  }

 private:
  // ---- Keys

  /// "found; required: what" of an exception, in its two halves.
  void refuse_by(const std::string& key, const std::invalid_argument& error) {
    const std::string words = error.what();
    const std::size_t at = words.find("; required: ");
    const bool has_both = at != std::string::npos;
    reader_.refuse(key, words.substr(0, at), has_both ? words.substr(at + 12) : "another form");
  }

  /// A ReplyForm or a CommandForm; an empty one if it is refused.
  template <class Form>
  Form form(const std::string& key, bool required) {
    std::string text;
    required ? reader_.required_text(key, text) : reader_.text(key, text);
    try {
      return Form(text);
    } catch (const std::invalid_argument& error) {
      refuse_by(key, error);
      return {};
    }
  }
  ReplyForm reply_form(const std::string& key, bool required) { return form<ReplyForm>(key, required); }
  CommandForm command_form(const std::string& key, bool required) { return form<CommandForm>(key, required); }

  std::vector<ReplyForm> reply_forms(const std::string& key) {
    std::vector<std::string> texts;
    reader_.texts(key, texts);
    std::vector<ReplyForm> forms;
    for (const std::string& text : texts) {
      try {
        forms.emplace_back(text);
      } catch (const std::invalid_argument& error) {
        refuse_by(key, error);
      }
    }
    return forms;
  }

  /// A question and its reply, of which a field is needed.
  DescribedExchange question(const std::string& field) {
    DescribedExchange out{command_form("send", true), reply_form("expect", true), {}};
    refuse_numbers("send", out.send, "");
    if (!field.empty() && !out.expect.empty() && !out.expect.has(field))
      reader_.refuse("expect", "\"" + out.expect.text() + "\"", "a reply with the field {" + field + "}");
    note(out.expect, "expect");
    return out;
  }

  /// Commands that change something: each is acknowledged, by its reply or by a question that reads it back.
  std::vector<DescribedExchange> commands(const std::string& section) {
    std::vector<DescribedExchange> all;
    reader_.section("");
    reader_.tables(section, 0, [&](std::size_t) {
      DescribedExchange one{command_form("send", true), reply_form("expect", false),
                            command_form("read_back", false)};
      reader_.boolean("silent", one.silent);
      if (one.expect.empty() && !one.silent && !one.send.empty()) {
        reader_.refuse(
            "send", fmt::format("\"{}\", which nothing acknowledges", one.send.text()),
            "expect = \"...\", the reply that accepts it, or read_back = \"...\" with the question "
            "that reads back what it has set, and its reply as expect, or silent = true with [error_query]: "
            "a command that nothing acknowledges may not have arrived");
      }
      if (one.silent && !(one.expect.empty() && one.read_back.empty()))
        reader_.refuse("silent", "true, and expect or read_back", "one of both");
      // A move that is lost ends elsewhere, which is seen; a speed that is lost is not seen.
      if (one.silent && section == "set_speed")
        reader_.refuse(
            "silent", "true in [[set_speed]]",
            "expect, the reply that accepts it, or read_back with {speed} in its reply: without an "
            "error the command may not have arrived all the same");
      has_silent_ = has_silent_ || one.silent;
      for (const char* field : {"angle", "speed"})
        if (!one.read_back.empty() && !one.expect.empty() && one.send.has(field) && !one.expect.has(field))
          reader_.refuse("expect", "\"" + one.expect.text() + "\"",
                         fmt::format("a reply with {{{}}}, which is compared with what was sent", field));
      if (!one.read_back.empty() && one.send.has("increment"))
        reader_.refuse("read_back", "of a move by an {increment}",
                       "expect = \"...\", the reply that accepts it: an increment cannot be read back");
      require_numbers(section, one);
      refuse_places("expect", one.expect);
      note(one.expect, "expect", true);
      all.push_back(std::move(one));
    });
    return all;
  }

  /// Refuses a number that nothing would replace.
  void require_numbers(const std::string& section, const DescribedExchange& one) {
    const std::string known = section == "set_speed" ? "speed"
                              : section != "move"    ? ""
                              : out_.by_increments   ? "increment"
                                                     : "angle";
    refuse_numbers("send", one.send, known, section == "move" && out_.usual_speed_deg_per_s);
    refuse_numbers("read_back", one.read_back, "");
  }
  void refuse_numbers(const char* key, const CommandForm& form, std::string_view known,
                      bool is_speed_known = false) {
    for (const char* field : {"angle", "angles", "increment", "speed"}) {
      if (!form.has(field) || (known == "angle" && field == std::string_view("angles")) || field == known ||
          (is_speed_known && field == std::string_view("speed")))
        continue;
      const bool is_speed_of_move = !known.empty() && field == std::string_view("speed");
      reader_.refuse(
          key, fmt::format("{{{}}} in \"{}\"", field, form.text()),
          known.empty()
              ? "no number: none is known here"
              : fmt::format(
                    "{{{}}}, the number that is known here{}", known,
                    is_speed_of_move ? ", or [speed] deg_per_s, the speed unless one is stated" : ""));
    }
  }

  /// Refuses places of axes where no axis is in question.
  void refuse_places(const char* key, const ReplyForm& form) {
    if (form.has_places())
      reader_.refuse(
          key, "\"" + form.text() + "\", a reply for all axes",
          "no {before} and {after}: they are known in the replies of [position], [status], [referenced], "
          "[speed], [scale] and [[travel.query]]");
  }

  /// Keeps a form for the checks between sections.
  void note(const ReplyForm& form, const std::string& key, bool is_acknowledgement = false) {
    if (form.empty()) return;
    PlacedForm placed{form, reader_.line(), reader_.name(key)};
    (is_acknowledgement ? acknowledgements_ : answers_).push_back(std::move(placed));
  }

  // ---- Sections

  void read_top() {
    reader_.section("");
    std::string schema;
    reader_.required_text("schema", schema, {kSchema});
    reader_.required_text("maker", out_.maker);
    reader_.texts("models", out_.models);
    if (out_.models.empty())
      reader_.refuse("models", "nothing", "the models of the identity, as [\"RT-2*\"]");
    std::vector<std::string> sources;
    reader_.texts("sources", sources);
    if (sources.empty())
      reader_.refuse("sources", "nothing", "where the facts are from, as [\"manual, 2nd edition\"]");
  }

  void read_transport() {
    reader_.section("transport");
    std::optional<int> baud;
    reader_.integer("baud", baud, 300, 4'000'000);
    if (baud) out_.baud = static_cast<unsigned>(*baud);
    reader_.boolean("rts_cts", out_.rts_cts);
    reader_.text("command_end", command_end_);
    if (command_end_.empty())
      reader_.refuse("command_end", "nothing", "what ends a command, as \"\\r\" or \"\\r\\n\"");
    reader_.boolean("echo", out_.echoes);
    out_.ignored = reply_forms("ignore");
    reader_.number("gap_s", out_.gap_s, {0.0, 5.0});
    reader_.number("reply_s", out_.reply_s, {0.01, 60.0});
    out_.last_line = reply_form("last_line", false);
    refuse_places("last_line", out_.last_line);
    reader_.text("address", out_.address);
  }

  void read_axes() {
    reader_.section("axes");
    reader_.texts("names", out_.axis_names);
    reader_.required_text("unit", unit_);
    reader_.number("units_per_degree", units_per_degree_, {1e-9, 1e12});
    reader_.number("speed_factor", out_.speed_factor, {1e-9, 1e12});
    std::optional<double> wraps;
    reader_.number("wraps_deg", wraps, {360.0, 360.0});
    out_.wraps = wraps.has_value();
    reader_.boolean("continuous", continuous_);
    reader_.text("path", path_, {"", "shortest", "increments"});
    out_.by_increments = path_ == "increments";
  }

  void read_identity() {
    reader_.section("");
    reader_.tables("identify", 0, [&](std::size_t) {
      out_.identify.push_back(question(""));
      refuse_places("expect", out_.identify.back().expect);
    });
    if (out_.identify.empty())
      reader_.refuse("identify", "nothing", "[[identify]] with send and expect, and {model} in one reply");
    const bool has_model = std::ranges::any_of(
        out_.identify, [](const DescribedExchange& each) { return each.expect.has("model"); });
    if (!out_.identify.empty() && !has_model)
      reader_.refuse("identify", "no reply with {model}", "the field {model} in one reply");
  }

  void read_motion() {
    if (reader_.gives("speed")) {
      reader_.section("speed");
      reader_.number("deg_per_s", out_.usual_speed_deg_per_s, {1e-6, 1e5});
      if (!out_.usual_speed_deg_per_s) out_.speed = question("speed");
      reader_.section("");
    }
    out_.prepare = commands("prepare");
    out_.home = commands("home");
    out_.move = commands("move");
    out_.set_speed = commands("set_speed");
    const char* field = out_.by_increments ? "increment" : "angle";
    reader_.section("");
    const auto sends = [](const std::vector<DescribedExchange>& all, std::string_view name) {
      return std::ranges::any_of(all, [&](const DescribedExchange& each) { return each.send.has(name); });
    };
    if (!sends(out_.move, field) && !sends(out_.move, "angles"))
      reader_.refuse("move", "no command with {" + std::string(field) + "}",
                     "[[move]] with send = \"... {" + std::string(field) + ":.4f}\"");
    if (out_.usual_speed_deg_per_s && (!sends(out_.move, "speed") || !out_.set_speed.empty()))
      reader_.refuse("speed", "deg_per_s", "a [[move]] with {speed}, and no [[set_speed]]");
    if (!out_.set_speed.empty() && !sends(out_.set_speed, "speed"))
      reader_.refuse("set_speed", "no command with {speed}", "[[set_speed]] with send = \"... {speed:.3f}\"");
    if (reader_.gives("scale")) {
      reader_.section("scale");
      reader_.boolean("in_bench_file", out_.scale_in_bench);
      if (!out_.scale_in_bench) out_.scale.push_back(question("units_per_turn"));
    }
  }

  void read_state() {
    reader_.section("position");
    out_.position = question("angle");
    const auto sends_angles =
        std::ranges::any_of(out_.move, [](const DescribedExchange& each) { return each.send.has("angles"); });
    if (sends_angles && !out_.position.expect.has_places())
      reader_.refuse("expect", "\"" + out_.position.expect.text() + "\", with {angles} in [[move]]",
                     "{before ,} and {after ,}: the angles of the other axes are read in the same reply");
    reader_.section("status");
    reader_.boolean("of_all_axes", out_.status_of_all);
    reader_.number("window_deg", out_.window_deg, {1e-6, 1.0});
    out_.status.send = command_form("send", true);
    refuse_numbers("send", out_.status.send, "");
    out_.moving = reply_form("moving", true);
    out_.stopped = reply_form("stopped", true);
    note(out_.moving, "moving");
    note(out_.stopped, "stopped");
    if (!out_.moving.empty() && !out_.stopped.empty()) {
      if (const auto both = reply_of_both(out_.moving, out_.stopped))
        reader_.refuse("stopped", fmt::format("a reply that is also `moving`, such as \"{}\"", *both),
                       "two forms that no reply fits both: what may be a motion is never taken for rest");
    }
    reader_.tables("fault", 0, [&](std::size_t) {
      out_.status_faults.push_back(fault());
      note(out_.status_faults.back().expect, "expect");
    });
    reader_.section("referenced");
    reader_.boolean("always", out_.always_referenced);
    reader_.boolean("by_hand", out_.referenced_by_hand);
    if (out_.referenced_by_hand && (out_.always_referenced || !out_.home.empty()))
      reader_.refuse("by_hand", "true, and always or [[home]]", "one of them");
    if (out_.always_referenced) {
      if (!out_.home.empty()) reader_.refuse("always", "true, and [[home]]", "one of both");
    } else {
      out_.referenced = DescribedExchange{command_form("send", true), {}, {}};
      refuse_numbers("send", out_.referenced->send, "");
      out_.is_referenced = reply_forms("yes");
      out_.is_not_referenced = reply_forms("no");
      for (const ReplyForm& form : out_.is_referenced) note(form, "yes");
      for (const ReplyForm& form : out_.is_not_referenced) note(form, "no");
      for (const char* key : {"yes", "no"})
        if ((key[0] == 'y' ? out_.is_referenced : out_.is_not_referenced).empty())
          reader_.refuse(key, "nothing", "forms of the replies, as [\"...\"]; or always = true");
      reader_.section("");
      if (out_.home.empty() && !out_.referenced_by_hand)
        reader_.refuse("home", "nothing",
                       "[[home]], or [referenced] always = true for absolute encoders, or by_hand = true if "
                       "a person finds the reference at the controller");
    }
    read_travel();
  }

  void read_travel() {
    reader_.section("travel");
    reader_.number("lower_deg", out_.lower_deg, {-36000.0, 36000.0});
    reader_.number("upper_deg", out_.upper_deg, {-36000.0, 36000.0});
    bool has_lower = out_.lower_deg.has_value(), has_upper = out_.upper_deg.has_value();
    reader_.tables("query", 0, [&](std::size_t) {
      out_.travel.push_back(question(""));
      has_lower = has_lower || out_.travel.back().expect.has("lower");
      has_upper = has_upper || out_.travel.back().expect.has("upper");
    });
    if (!out_.wraps && !(has_lower && has_upper)) {
      reader_.section("");
      reader_.refuse(
          "travel", "not both ends",
          "[travel] lower_deg and upper_deg, or [[travel.query]] with {lower} and {upper}; an axis "
          "without ends has [axes] wraps_deg = 360");
    }
    if (out_.lower_deg && out_.upper_deg && !(*out_.lower_deg < *out_.upper_deg))
      reader_.refuse("lower_deg", fmt::format("{:g} to {:g}", *out_.lower_deg, *out_.upper_deg),
                     "lower_deg < upper_deg");
  }

  DescribedFault fault() {
    DescribedFault out;
    out.expect = reply_form("expect", true);
    std::string name;
    static const std::vector<std::pair<std::string, Fault>> kFaults{{"refused", Fault::kRefused},
                                                                    {"not_ready", Fault::kNotReady},
                                                                    {"out_of_travel", Fault::kOutOfTravel},
                                                                    {"stalled", Fault::kStalled}};
    reader_.required_text("fault", name, {"refused", "not_ready", "out_of_travel", "stalled"});
    for (const auto& [word, value] : kFaults)
      if (word == name) out.fault = value;
    reader_.text("says", out.says);
    return out;
  }

  /// The bytes of a text in which a character up to U+00FF stands for the byte with its number.
  std::string bytes_of(const std::string& text) {
    std::string bytes;
    for (std::size_t at = 0; at < text.size(); ++at) {
      const auto byte = static_cast<unsigned char>(text[at]);
      if (byte > 0xC3U) {
        reader_.refuse("raw", "a character above U+00FF", "bytes, as \"\\u0085\" for 0x85");
        return bytes;
      }
      bytes +=
          byte < 0x80U
              ? text[at]
              : static_cast<char>(((byte & 0x03U) << 6U) | (static_cast<unsigned char>(text[++at]) & 0x3FU));
    }
    return bytes;
  }

  void read_halt() {
    reader_.section("halt");
    const CommandForm send_form = command_form("send", false), raw_form = command_form("raw", false);
    refuse_numbers("send", send_form, "");
    refuse_numbers("raw", raw_form, "");
    const std::string &send = send_form.text(), &raw = raw_form.text();
    out_.halt_reply = reply_form("expect", false);
    note(out_.halt_reply, "expect", true);
    reader_.text("spoil", out_.spoil);
    std::string half;
    reader_.text("half_command", half, {"", "executed"});
    out_.half_command_executed = !half.empty();
    if (out_.half_command_executed && !out_.spoil.empty())
      reader_.refuse("half_command", "\"executed\", and spoil",
                     "spoil, if the controller refuses a command that ends so; else half_command alone");
    if (out_.half_command_executed && out_.gap_s > 0.0)
      reader_.refuse("half_command", "\"executed\", with [transport] gap_s",
                     "spoil: a motion that the half-written command begins would last until the gap is over");
    if (out_.spoil.empty() && !out_.half_command_executed)
      reader_.refuse(
          "spoil", "nothing",
          "characters that make a half-written command one that is refused, as spoil = \" ?\": the "
          "program may die in the middle of a move's angle. If none does: half_command = \"executed\"");
    if (send.empty() == raw.empty()) {
      reader_.section("");
      reader_.refuse("halt", send.empty() ? "no command" : "send and raw",
                     "[halt] with send = \"...\", a command that stops all axes, or raw = \"...\", bytes "
                     "without the end of a command: a stage that cannot be halted is not driven");
    }
    out_.halt = raw.empty() ? send + command_end_ : bytes_of(raw);
    out_.command_end = command_end_;
    if (out_.gap_s > 0.0 && raw.find("{axis}") != std::string::npos)
      reader_.refuse("raw", "a stop of each axis, with [transport] gap_s",
                     "one command that stops all axes, or send: bytes without an end are not told apart");
  }

  void read_errors() {
    reader_.section("");
    reader_.tables("error", 0, [&](std::size_t) {
      out_.errors.push_back(fault());
      refuse_places("expect", out_.errors.back().expect);
      if (!out_.errors.back().expect.empty())
        refusals_.push_back({out_.errors.back().expect, reader_.line(), reader_.name("expect")});
    });
  }

  void read_error_query() {
    reader_.section("");
    const bool has_query = reader_.gives("error_query");
    if (has_silent_ && !has_query)
      reader_.refuse(
          "error_query", "nothing, and commands with silent = true",
          "[error_query] with send, the question for the controller's last error, and none, the reply "
          "without one");
    if (!has_query) return;
    reader_.section("error_query");
    out_.error_query = DescribedExchange{command_form("send", true), reply_form("none", true), {}};
    refuse_numbers("send", out_.error_query->send, "");
    note(out_.error_query->expect, "none");
    refuse_places("none", out_.error_query->expect);
    const ReplyPattern none = out_.error_query->expect.pattern();
    reader_.tables("fault", 0, [&](std::size_t) {
      out_.queried_errors.push_back(fault());
      const ReplyForm& form = out_.queried_errors.back().expect;
      note(form, "expect");
      refuse_places("expect", form);
      if (form.empty()) return;
      if (const auto both = common_reply(none, form.pattern()))
        reader_.refuse("expect", fmt::format("\"{}\", which can be `none` too: \"{}\"", form.text(), *both),
                       "two forms that no reply fits both");
    });
    if (out_.queried_errors.empty()) {
      reader_.section("");
      reader_.refuse("error_query", "no replies with an error",
                     "[[error_query.fault]] with expect and fault");
    }
  }

  void read_emulator() {
    reader_.section("emulator");
    std::vector<std::string> drivers;
    for (const CataloguedDriver& driver : driver_catalogue().stages)
      if (driver.has_port) drivers.push_back(driver.name);
    reader_.text("driver", out_.emulator_firmware, drivers);
    for (const char* field : {"model", "firmware"}) {
      std::string value;
      reader_.text(field, value);
      if (!value.empty()) out_.emulator_values[field] = value;
    }
    reader_.text("unknown", out_.emulator_unknown);
  }

  // ---- Checks between sections

  void check_scale() {
    const bool asked = !out_.scale.empty() || out_.scale_in_bench;
    reader_.section("axes");
    if (unit_ != "deg" && !unit_.empty() && !units_per_degree_ && !asked)
      reader_.refuse(
          "unit", "\"" + unit_ + "\" without a scale",
          "units_per_degree, or [scale] that asks for {units_per_turn}, or [scale] in_bench_file = "
          "true if motor and gear decide it");
    if (units_per_degree_ && asked)
      reader_.refuse("units_per_degree", fmt::format("{:g}, and [scale]", *units_per_degree_), "one of both");
    if (unit_ == "deg" && (units_per_degree_ || asked))
      reader_.refuse("unit", "\"deg\" with another scale", "the unit of the angles on the line");
    out_.units_per_degree = units_per_degree_.value_or(1.0);
  }

  /// A command without the name of its axis would be for both.
  void check_axes() {
    if (out_.axis_names.size() == 1) return;
    reader_.section("");
    const auto check = [&](const char* key, const CommandForm& send, const ReplyForm& reply = {}) {
      if (!send.empty() && !send.has("axis") && !reply.has_places())
        reader_.refuse(key, "\"" + send.text() + "\" without {axis}",
                       "{axis}, the name of the axis; or {before ,} and {after ,} in replies for all axes; "
                       "or [axes] names "
                       "with one name, for a controller of one axis");
    };
    const auto first_move = std::ranges::find_if(out_.move, [](const DescribedExchange& each) {
      return each.send.has("angle") || each.send.has("increment");
    });
    if (first_move != out_.move.end()) check("move", first_move->send);
    check("position", out_.position.send, out_.position.expect);
    if (!out_.status_of_all) check("status", out_.status.send, out_.moving);
    if (out_.moving.has_places() != out_.stopped.has_places())
      reader_.refuse("status", "{before} in one of moving and stopped",
                     "{before} and {after} in both, or in none");
  }

  /// Replies for all axes: the place of an axis is that of its name.
  void check_places() {
    if (out_.axis_names.size() > 1) return;
    for (const PlacedForm& placed : answers_)
      if (placed.form.has_places())
        reader_.add_problem_at(placed.line, placed.where,
                               "\"" + placed.form.text() + "\" without the names of the axes",
                               "[axes] names with all axes of the controller, in the order of its replies");
  }

  void check_wrap() {
    reader_.section("axes");
    if (continuous_ && !out_.wraps)
      reader_.refuse(
          "continuous", "true without wraps_deg",
          "wraps_deg = 360: an axis that turns for ever counts modulo 360, or its angle has no end");
    if (out_.wraps && path_.empty())
      reader_.refuse("wraps_deg", "360 without path",
                     "path = \"shortest\", if the controller takes the shorter way, or \"increments\"");
    if (!out_.wraps && !path_.empty())
      reader_.refuse("path", "\"" + path_ + "\" without wraps_deg", "wraps_deg = 360, or no path");
  }

  /// Replies that could be taken for others.
  void check_replies() {
    for (const PlacedForm& answer : answers_) {
      if (out_.last_line.empty()) break;
      const PlacedForm last{out_.last_line, answer.line, answer.where};
      if (const auto both = reply_of_both(last.form, answer.form))
        reader_.add_problem_at(answer.line, answer.where,
                               fmt::format("\"{}\", which can be the last line of a reply too: \"{}\"",
                                           answer.form.text(), *both),
                               "two forms that no reply fits both");
    }
    for (const PlacedForm& refusal : refusals_) {
      for (const PlacedForm& acknowledgement : acknowledgements_)
        check_pair(refusal, acknowledgement, "an acknowledgement");
      for (const PlacedForm& answer : answers_) check_pair(refusal, answer, "an answer");
    }
    if (out_.identify.empty() || out_.identify[0].expect.empty()) return;
    bool is_first = true;  // The identity itself.
    for (const std::vector<PlacedForm>* forms : {&answers_, &acknowledgements_, &refusals_}) {
      for (const PlacedForm& other : *forms) {
        if (std::exchange(is_first, false)) continue;
        if (const auto both = reply_of_both(out_.identify[0].expect, other.form))
          reader_.add_problem_at(
              other.line, other.where,
              fmt::format("\"{}\", a reply that can be that of the first [[identify]] too: \"{}\"",
                          other.form.text(), *both),
              "two forms that no reply fits both: the identity tells late replies from new ones");
      }
    }
  }

  /// A reply that fits both forms, for an axis at any place.
  std::optional<std::string> reply_of_both(const ReplyForm& one, const ReplyForm& other) const {
    const bool has_places = one.has_places() || other.has_places();
    const std::size_t places = has_places ? std::max<std::size_t>(1, out_.axis_names.size()) : 1;
    for (std::size_t place = 1; place <= places; ++place)
      if (const auto both = common_reply(one.at(place).pattern(), other.at(place).pattern())) return both;
    return std::nullopt;
  }

  void check_pair(const PlacedForm& refusal, const PlacedForm& other, const char* word) {
    if (const auto both = reply_of_both(refusal.form, other.form))
      reader_.add_problem_at(refusal.line, refusal.where,
                             fmt::format("\"{}\" can be {} too (line {}, {}): \"{}\"", refusal.form.text(),
                                         word, other.line, other.where, *both),
                             "two forms that no reply fits both");
  }

  TomlReader& reader_;
  StageDescription& out_;
  std::string command_end_, unit_, path_;
  std::optional<double> units_per_degree_;
  bool continuous_ = false, has_silent_ = false;
  std::vector<PlacedForm> acknowledgements_, answers_, refusals_;
};

}  // namespace

StageDescription parse_stage_description(std::string_view text, const std::string& source,
                                         std::vector<Problem>& problems) {
  StageDescription out;
  out.text = text;
  out.source = source;
  out.sha256 = sha256_of(text);
  std::vector<Problem> unreadable;
  const toml::table root = parse_toml(text, source, kKind, unreadable);
  const bool is_empty = root.empty() && !unreadable.empty();
  std::ranges::move(unreadable, std::back_inserter(problems));
  if (is_empty) return out;
  TomlReader reader(root, {}, text);
  DescriptionReader(reader, out).read();
  reader.report_unknown();
  std::ranges::move(reader.take_problems(), std::back_inserter(problems));
  return out;
}

std::string stage_description_text(const std::string& name_or_path, std::vector<Problem>& problems) {
  for (const ShippedDescription& shipped : shipped_descriptions())
    if (shipped.name == name_or_path) return std::string(shipped.text);
  std::error_code ignored;
  if (name_or_path.find_first_of("./") == std::string::npos &&
      !std::filesystem::exists(name_or_path, ignored)) {
    std::vector<std::string> names;
    for (const ShippedDescription& shipped : shipped_descriptions()) names.emplace_back(shipped.name);
    problems.push_back({"the description", "\"" + name_or_path + "\"", "a file, or one of " + joined(names)});
    return {};
  }
  return read_text_file(name_or_path, "description of a stage", problems);
}

StageDescription stage_description_of(const StageConfig& stage) {
  std::vector<Problem> problems;
  const std::string& kept = stage.description_text;
  const std::string text = kept.empty() ? stage_description_text(stage.description, problems) : kept;
  StageDescription out;
  if (problems.empty()) out = parse_stage_description(text, stage.description, problems);
  if (!problems.empty())
    throw std::invalid_argument(fmt::format("description {}: {} problem{}{}", stage.description,
                                            problems.size(), problems.size() == 1 ? "" : "s",
                                            list_of(problems)));
  return out;
}

}  // namespace abcal
