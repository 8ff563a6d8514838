#pragma once

#include <cstddef>
#include <functional>

namespace abcal {

/// Calls `each` with 0 .. count - 1, on as many threads as the machine has processors. Each call may write
/// only to data of its own number. The first exception, by number, is thrown once all have ended.
void side_by_side(std::size_t count, const std::function<void(std::size_t)>& each);

}  // namespace abcal
