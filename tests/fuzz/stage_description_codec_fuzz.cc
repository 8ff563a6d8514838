// Fuzz target of the reader of descriptions: any text is read or refused, with words for each problem; and a
// description that is accepted has a halt, an acknowledgement of each command, and replies that the driver
// and the guard take for the same.

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/stage_description_file.h"
#include "drivers/wire/reply_match.h"

namespace {

using abcal::DescribedExchange;
using abcal::ReplyForm;
using abcal::StageDescription;

void require(bool condition) {
  if (!condition) __builtin_trap();
}

void check_form(const ReplyForm& form) {
  for (const std::size_t place : {1U, 2U, 9U}) {
    const ReplyForm at = form.at(place);
    const std::string reply = at.reply({});
    if (reply.size() > abcal::kLongestHaltReply) continue;
    require(at.match(reply).has_value());
    require(abcal::wire::matches(at.pattern(), reply));
  }
}

void check_commands(const StageDescription& description, const std::vector<DescribedExchange>& commands) {
  for (const DescribedExchange& each : commands) {
    require(!each.send.empty());
    require(each.silent ? description.error_query.has_value() : !each.expect.empty());
    if (!each.silent) check_form(each.expect);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  std::vector<abcal::Problem> problems;
  const StageDescription read = abcal::parse_stage_description(text, "fuzz", problems);
  for (const abcal::Problem& problem : problems) require(!problem.found.empty() && !problem.required.empty());
  if (!problems.empty()) return 0;
  require(!read.halt.empty());
  require(read.half_command_executed != !read.spoil.empty());
  require(!read.half_command_executed || read.gap_s == 0.0);
  for (const auto* commands : {&read.prepare, &read.home, &read.move, &read.set_speed})
    check_commands(read, *commands);
  for (const DescribedExchange& each : read.set_speed) require(!each.silent);
  for (const ReplyForm* form : {&read.moving, &read.stopped, &read.position.expect}) check_form(*form);
  for (const std::size_t place : {1U, 2U}) {
    if (!read.moving.has_places() && place > 1) break;
    const ReplyForm moving = read.moving.at(place), stopped = read.stopped.at(place);
    require(!stopped.match(moving.reply({})));
    require(!moving.match(stopped.reply({})));
  }
  return 0;
}
