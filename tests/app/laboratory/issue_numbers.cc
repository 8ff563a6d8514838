// Gives numbers to certificates, in a process of its own. Arguments: register, person, password, name, count.
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <string>

#include "app/laboratory/register/register.h"
#include "app/system/real_clock.h"
#include "protocol/record/sha256.h"

int main(int, char** words) {
  using namespace abcal;
  try {
    lab::Register opened = lab::Register::open(words[1], RealClock().utc_now());
    const std::string token = opened.log_in(words[2], words[3], RealClock().utc_now(), std::chrono::hours(1));
    const lab::LoggedIn approver = opened.who(token, RealClock().utc_now());
    for (int k = 0; k < std::atoi(words[5]); ++k) {
      const std::string run = std::string(words[4]) + "-" + std::to_string(k);
      const std::string number =
          opened
              .reserve_number(approver, {sha256_of(run), "an item", "Operator N. N.", {}, {}},
                              RealClock().utc_now())
              .number;
      opened.record_issued(approver, number, sha256_of("xml of " + run), "2026-03-01", RealClock().utc_now());
      std::printf("%s %s\n", number.c_str(), run.c_str());
    }
    return 0;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
