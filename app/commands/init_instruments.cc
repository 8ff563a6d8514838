#include "app/commands/init_instruments.h"

#include <fmt/format.h>

#include <optional>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "app/bench_file/item_identity.h"
#include "app/commands/demo_bench.h"
#include "app/commands/init_answers.h"
#include "app/commands/init_question.h"
#include "app/commands/port_listing.h"
#include "app/system/interrupt.h"
#include "app/system/output.h"
#include "app/system/text_layout.h"
#include "drivers/text/text.h"

namespace abcal {
namespace {

std::string name_of(const ProbeAnswer& answer) {
  return in_words(ItemNames{answer.maker, answer.model, answer.serial_number});
}

/// The instrument on a port, or why none was found. How a bench file names it is the work of init.
std::string found_text(const Probed& probed) {
  if (probed.failure.starts_with(probed.port + ": ")) return indented(probed.failure);
  const bool is_known = probed.answer && !probed.answer->driver.empty();
  return indented(fmt::format(
      "{}: {}", probed.port,
      is_known ? fmt::format("{}: {}", probed.answer->role(), name_of(*probed.answer)) : in_words(probed)));
}

/// Asks the ports unless the person ends it.
std::vector<Probed> probe_for_init(const std::vector<std::string>& ports) {
  std::vector<Probed> probed = probe_with_bar(ports, interrupt_token());
  if (interrupt_token().stop_requested()) end_without_an_answer();
  for (const Probed& one : probed) print_log("{}", found_text(one));
  return probed;
}

/// Lines of a list from which one is chosen by its number.
std::string numbered(const std::vector<Probed>& list) {
  std::string text;
  for (std::size_t n = 0; n < list.size(); ++n)
    text += wrapped(fmt::format("{}: {}{}", list[n].port, name_of(*list[n].answer),
                                list.size() == 1 ? " (an empty line means this one)" : ""),
                    fmt::format("  {}  ", n + 1), "     ", kTerminalColumns);
  return text;
}

}  // namespace

Instruments::Instruments(std::string& stage, std::string& item, std::filesystem::path folder)
    : stage_answer_(stage), item_answer_(item), folder_(std::move(folder)) {
  if (stage == kEmulated) return;
  listed_ = wire::list_ports();
  std::vector<std::string> given;
  for (const std::string& port : {stage, item})
    if (!port.empty()) given.push_back(port);
  if (given.size() < 2) {
    print_log("Serial ports of this computer:\n{}", listed_.empty() ? "  none\n" : "");
    for (const wire::PortInfo& port : listed_) print_log("{}", port_text(port));
  }
  const std::vector<std::string> ports = ports_for(given, 2, listed_);
  if (!ports.empty())
    print_log("Asking {} which instrument is there. Nothing moves.\n",
              ports.size() == 1 ? "one port" : fmt::format("{} ports", ports.size()));
  probed_ = probe_for_init(ports);
}

Instruments::~Instruments() {
  if (!emulation_) return;
  emulation_.reset();  // Its links go with it.
  std::error_code ignored;
  std::filesystem::remove(folder_, ignored);  // Only if it is empty.
}

ProbeAnswer Instruments::stage() {
  const std::vector<Probed> list = candidates(probed_, "stage");
  const Question question{
      "Which stage turns the item?",
      numbered(list) + indented(fmt::format(
                           "{}, or `emulated` for a bench without hardware.",
                           list.empty() ? "None answers. Switch it on, then give its port, such as "
                                          "tcp:192.168.0.5:50000 or /dev/ttyUSB0"
                                        : "Give its number, or another port such as tcp:192.168.0.5:50000")),
      "--stage"};
  const Probed stage = ask(question, stage_answer_, [&](const std::string& answer) {
    return pieces::trimmed(answer) == kEmulated ? emulated_stage() : at_port(list, answer, "stage");
  });
  if (!emulation_) stage_answer_ = stage.port;
  stage_port_ = stage.port;
  return *stage.answer;
}

ProbeAnswer Instruments::item() {
  if (emulation_) {
    item_port_ = (folder_ / "accelerometer").string();
    ProbeAnswer item;
    item.driver = emulated_.items.front().accelerometer.driver;
    return item;
  }
  const std::vector<Probed> list = candidates(probed_, "accelerometer");
  const Question question{
      "Which accelerometer is calibrated?",
      numbered(list) + indented(list.empty() ? "None answers. Switch it on, then give its port."
                                             : "Give its number, or another port."),
      "--item"};
  const Probed item = ask(question, item_answer_, [&](const std::string& answer) {
    if (pieces::trimmed(answer) == kEmulated)
      throw std::invalid_argument(
          "an emulated item needs the emulated stage; required: a port (Ctrl-C, then `abcal init --stage "
          "emulated`, for a bench without hardware)");
    return at_port(list, answer, "accelerometer");
  });
  item_answer_ = item.port;
  item_port_ = item.port;
  return *item.answer;
}

std::string Instruments::stage_port() const {
  return stable_port_name(stage_port_, listed_);
}

std::string Instruments::item_port() const {
  return stable_port_name(item_port_, listed_);
}

/// The instrument that an answer means; a port that was not asked yet is asked now.
Probed Instruments::at_port(const std::vector<Probed>& list, const std::string& answer,
                            std::string_view role) {
  std::optional<Probed> probed = chosen(list, answer);
  const std::string port(pieces::trimmed(answer));
  for (const Probed& each : probed_)
    if (!probed && each.port == port) probed = each;
  if (!probed) {
    (void)wire::parse_port(port);
    probed = probe_for_init({port}).front();
  }
  require_role(*probed, role);
  return *probed;
}

/// Starts an emulated bench. Its instruments are known and are not asked.
Probed Instruments::emulated_stage() {
  emulated_ = parse_bench(demo_bench(folder_, 72), "the emulated bench");
  std::filesystem::create_directories(folder_);
  emulation_ = std::make_unique<Emulation>("the emulated bench", emulated_, folder_);
  print_log("  Emulated instruments answer in {}.\n  Nothing real moves.\n", folder_.string());
  ProbeAnswer stage;
  stage.driver = emulated_.stage.driver;
  stage.stage = true;
  stage.axes = {emulated_.stage.x.axis, emulated_.stage.z.axis};
  return {(folder_ / "stage").string(), stage, ""};
}

}  // namespace abcal
