#pragma once

#include <string>

#include "protocol/record/run_operator.h"

namespace abcal::console {

/// The page and the person that request something at the bench.
struct Asker {
  std::string page;   ///< "page 3 at 127.0.0.1:50000"
  RunOperator who;    ///< The person of the register who is logged in there; without a name: nobody.
  std::string login;  ///< Secret by which the register knows the person.

  /// For people: "Operator N. N., page 3 at 127.0.0.1:50000".
  std::string for_people() const { return who.name.empty() ? page : who.name + ", " + page; }
  /// For the event log of a run, which names the register as well.
  std::string for_record() const {
    return who.verified() ? who.name + ", register " + who.register_identity + ", " + page : for_people();
  }
};

}  // namespace abcal::console
