#pragma once

#include <pybind11/pybind11.h>

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include "abcal/bench.h"

namespace abcal::python {

namespace py = pybind11;

/// Events from the thread that works to the one that called.
class EventQueue {
 public:
  void push(const Event& event) {
    const std::lock_guard lock(mutex_);
    events_.push_back(event);
    wake_.notify_one();
  }
  void end() {
    const std::lock_guard lock(mutex_);
    ended_ = true;
    wake_.notify_one();
  }
  /// The next event; nothing after `patience`. @return false: no more events will follow
  bool next(std::optional<Event>& event, std::chrono::milliseconds patience) {
    std::unique_lock lock(mutex_);
    wake_.wait_for(lock, patience, [&] { return ended_ || !events_.empty(); });
    event.reset();
    if (events_.empty()) return !ended_;
    event = std::move(events_.front());
    events_.pop_front();
    return true;
  }

 private:
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Event> events_;
  bool ended_ = false;
};

/// Passes an event to Python, and lets Python look for Ctrl-C.
inline void call_python(const py::object& callback, const std::optional<Event>& event) {
  if (event && !callback.is_none()) callback(py::module_::import("json").attr("loads")(event->json));
  if (PyErr_CheckSignals() != 0) throw py::error_already_set();
}

/// Works in a thread of its own, without Python's lock, while this one gives events to `callback` and looks
/// for Ctrl-C. The hardware never waits for Python. An exception of Python ends the work by `halt`; it is
/// thrown when the work has ended.
template <class Outcome>
Outcome carry_out(const std::function<Outcome(const Listener&)>& work, const std::function<void()>& halt,
                  const py::object& callback) {
  constexpr std::chrono::milliseconds kPatience{20};
  EventQueue queue;
  std::optional<Outcome> outcome;
  std::exception_ptr failure;
  std::thread worker([&] {
    try {
      outcome.emplace(work([&](const Event& event) { queue.push(event); }));
    } catch (...) {
      failure = std::current_exception();  // thrown below
    }
    queue.end();
  });
  std::optional<py::error_already_set> raised;
  std::optional<Event> event;
  for (bool more = true; more;) {
    {
      const py::gil_scoped_release release;
      if (raised) halt();  // Again: the first time, the work may not have begun.
      more = queue.next(event, kPatience);
    }
    if (raised) continue;
    try {
      call_python(callback, event);
    } catch (py::error_already_set& error) {
      raised.emplace(std::move(error));
    }
  }
  {
    const py::gil_scoped_release release;
    worker.join();
  }
  if (raised) throw std::move(*raised);
  if (failure) std::rethrow_exception(failure);
  return std::move(*outcome);
}

}  // namespace abcal::python
