#pragma once

#include <string>
#include <vector>

namespace abcal::test {

/// A block of commands of a page, with what the page says of them.
struct PageStep {
  std::string prose_before;           ///< Since the block before.
  std::vector<std::string> commands;  ///< As they stand.
  std::string output;                 ///< The block of output that follows; empty: none is shown.
  std::string prose_after;            ///< Up to the next block of commands or heading.
};

/// The steps of a page in their order, up to the heading "## Your own instruments" or "## Where to go from
/// here": what stands below needs real instruments, or is no step.
std::vector<PageStep> steps_of_page(const std::string& page);

/// Which figures of an output have to be those of the page.
enum class Figures {
  kOfThePage,  ///< All that the random digits of the emulated instruments do not reach.
  kAny,        ///< None: the run is another one.
};

/// How an output differs from what a page shows of it; empty: it does not.
///
/// Both are compared word by word; where lines break does not matter. In the page
/// - "..." at the end of a line, or alone on one, stands for anything, from within a word too;
/// - a date, the year in the number of a certificate, and a SHA-256 stand for any other;
/// - a value that is followed by "+- U" stands for every value within U of it, and U for those within a
///   factor of 1.5: the emulated instruments add random noise;
/// - the number after "chi2", "P =" and "|E_n| is" stands for any number: they are statistics of that noise.
std::string difference_from_page(const std::string& page, const std::string& output, Figures figures);

/// The text that a terminal shows in the end of everything that was written to it: progress bars that were
/// drawn over are gone, and colours are left out.
std::string as_shown(const std::string& written);

}  // namespace abcal::test
