#pragma once

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "app/operate/bench/halt_guard.h"
#include "drivers/instrument/halt.h"

namespace abcal {

/// A port that is handed to a guard, and again to the next guard if that one has died.
class PortHandover {
 public:
  /// @param descriptor  of the port now; -1: it is not open
  PortHandover(std::shared_ptr<HaltGuard> guard, std::string port, std::function<int()> descriptor)
      : guard_(std::move(guard)), port_(std::move(port)), descriptor_(std::move(descriptor)) {}

  /// Hands the port over, with the recipes that `recipes` returns, unless the running guard has it already. A
  /// port that is not open is not handed over.
  /// @return whether it changed hands
  /// @throws std::runtime_error as HaltGuard::hold(); exceptions of `recipes`
  template <class Recipes>
  bool ensure(const Recipes& recipes) {
    if (guard_->generation() == held_by_) return false;
    const int descriptor = descriptor_();
    if (descriptor < 0) return false;
    guard_->hold({port_, recipes()}, descriptor);
    held_by_ = guard_->generation();
    return true;
  }

  const std::string& port() const { return port_; }
  pid_t guard_process() const { return guard_->process(); }

 private:
  std::shared_ptr<HaltGuard> guard_;
  std::string port_;
  std::function<int()> descriptor_;
  int held_by_ = 0;  ///< Generation of the guard that holds the port; 0: none.
};

}  // namespace abcal
