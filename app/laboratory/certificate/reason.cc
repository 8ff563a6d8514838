#include "app/laboratory/certificate/reason.h"

namespace abcal {
namespace {

Message where_of(const Reason& reason) {
  if (reason.run.empty() || reason.part.empty()) return reason.run.empty() ? reason.part : reason.run;
  return {"{run}, {part}", reason.run, reason.part};
}

}  // namespace

Message Reason::message() const {
  return {"{where}: found {found}; required: {required}", where_of(*this), found, required};
}

Problem Reason::problem() const {
  return {where_of(*this), found, required};
}

std::vector<Problem> problems_of(const std::vector<Reason>& reasons) {
  std::vector<Problem> problems;
  for (const Reason& reason : reasons) problems.push_back(reason.problem());
  return problems;
}

Message quoted(const std::string& text) {
  return text.empty() ? Message("nothing") : Message("\"{text}\"", text);
}

}  // namespace abcal
