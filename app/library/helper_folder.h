#pragma once

namespace abcal::v1 {

/// The program finds its helper programs and data in its own folder. A library in another program finds them
/// in the library's folder, or in libexec and share of the prefix in which it is installed. Done once.
[[gnu::visibility("hidden")]] void find_helpers();

}  // namespace abcal::v1
