#include "app/console/workshop.h"

#include <malloc.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <boost/asio/post.hpp>
#include <set>
#include <utility>

#include "app/system/version.h"
#include "protocol/record/sha256.h"

namespace abcal::console {
namespace {

/// Lowers the priority of this thread, so that products of old runs do not slow the current run.
void yield_to_measuring() {
  constexpr int kLessThanMeasuring = 10;
  thread_local bool done = false;
  if (!std::exchange(done, true))
    ::setpriority(PRIO_PROCESS, static_cast<id_t>(::gettid()), kLessThanMeasuring);
}

/// Returns free memory to the system. A product is made from many small pieces (a list of a thousand runs, an
/// analysis), which glibc would keep for the thread at their largest amount.
void give_back_memory() {
#ifdef __GLIBC__
  ::malloc_trim(0);
#endif
}

}  // namespace

void require_wanted(const std::stop_token& cancelled) {
  if (cancelled.stop_requested()) throw Cancelled("cancelled: nobody waits for it any more");
}

// ---- Workshop

struct Workshop::Order {
  std::string name;
  Make make;
  Turn turn;
  std::stop_source stop;
  std::map<std::uint64_t, Done> waiting;
};

/// The orders in progress; used in the thread of the connections only.
struct Workshop::Book : std::enable_shared_from_this<Book> {
  Book(boost::asio::io_context& connections, boost::asio::thread_pool& threads, std::size_t thread_count)
      : io(connections), pool(&threads), free_threads(thread_count) {}

  boost::asio::io_context& io;
  boost::asio::thread_pool* pool;  ///< Null: closed.
  std::size_t free_threads;
  std::map<std::string, std::shared_ptr<Order>> by_name;
  std::list<std::shared_ptr<Order>> queue;  ///< Orders that wait for a thread, oldest first.
  std::set<std::string> being_served;       ///< Persons of the orders that have one.
  std::size_t in_progress = 0;
  std::uint64_t tickets = 0;

  void forget(const Order& order) {
    const auto found = by_name.find(order.name);
    if (found != by_name.end() && found->second.get() == &order) by_name.erase(found);
    std::erase_if(queue, [&](const auto& each) { return each.get() == &order; });
  }

  void finish(Order& order, const std::shared_ptr<const Product>& product) {
    forget(order);
    for (const auto& [waits, tell] : std::exchange(order.waiting, {})) {
      --in_progress;
      tell(product);
    }
  }

  void enqueue(const std::shared_ptr<Order>& order) {
    const auto is_of_same_person = [&](const auto& each) {
      return !order->turn.of.empty() && each->turn.of == order->turn.of;
    };
    if (std::ranges::count_if(queue, is_of_same_person) >= Turn::kMostWaiting) {
      const auto older = std::ranges::find_if(queue, is_of_same_person);
      boost::asio::post(io, [book = shared_from_this(), replaced = *older] {
        static const auto kReplaced = std::make_shared<const Product>(Product{
            429, "text/plain; charset=utf-8", "A newer request of the same person took its place.\n"});
        book->finish(*replaced, kReplaced);
      });
      queue.erase(older);
    }
    queue.push_back(order);
    begin_next();
  }

  /// Gives free threads to the orders whose turn it is.
  void begin_next() {
    while (pool != nullptr && free_threads > 0) {
      const auto may_begin = [&](const auto& each) { return !being_served.contains(each->turn.of); };
      auto next =
          std::ranges::find_if(queue, [&](const auto& each) { return each->turn.first && may_begin(each); });
      if (next == queue.end()) next = std::ranges::find_if(queue, may_begin);
      if (next == queue.end()) return;
      begin(*next);
      queue.erase(next);
    }
  }

  void begin(const std::shared_ptr<Order>& order) {
    --free_threads;
    if (!order->turn.of.empty()) being_served.insert(order->turn.of);
    boost::asio::post(*pool, [book = shared_from_this(), order, stop = order->stop.get_token()] {
      yield_to_measuring();
      std::shared_ptr<const Product> product;
      try {
        require_wanted(stop);
        product = order->make(stop);
      } catch (const std::exception& error) {
        product = std::make_shared<Product>(
            Product{422, "text/plain; charset=utf-8", std::string(error.what()) + "\n"});
      }
      give_back_memory();
      boost::asio::post(book->io, [book, order, product] {
        ++book->free_threads;
        book->being_served.erase(order->turn.of);
        book->begin_next();
        book->finish(*order, product);
      });
    });
  }
};

Workshop::Workshop(boost::asio::io_context& io, std::size_t threads)
    : book_(std::make_shared<Book>(io, pool_, threads)), pool_(threads) {}

Workshop::Ticket Workshop::order(const std::string& name, Make make, Done done, Turn turn) {
  const std::uint64_t number = ++book_->tickets;
  // A name begins with "/", so that a number is never shared.
  const std::string known_as = name.empty() ? std::to_string(number) : "/" + name;
  std::shared_ptr<Order>& place = book_->by_name[known_as];
  const bool is_new = place == nullptr;
  if (is_new)
    place = std::make_shared<Order>(
        Order{.name = known_as, .make = std::move(make), .turn = std::move(turn), .stop = {}, .waiting = {}});
  const std::shared_ptr<Order> order = place;
  order->waiting[number] = std::move(done);
  ++book_->in_progress;
  if (is_new) book_->enqueue(order);
  return {order.get(), [book = book_, order, number](Order*) {
            if (order->waiting.erase(number) == 0) return;  // It was notified already.
            --book->in_progress;
            if (!order->waiting.empty()) return;
            book->forget(*order);
            order->stop.request_stop();
          }};
}

void Workshop::close() {
  for (const auto& [name, order] : book_->by_name) order->stop.request_stop();
  book_->pool = nullptr;
  book_->queue.clear();
  pool_.stop();
  pool_.join();
}

std::size_t Workshop::in_progress() const {
  return book_->in_progress;
}

// ---- ProductCache

std::string ProductCache::hash_of(const std::filesystem::path& file) {
  std::error_code error;
  const auto time = std::filesystem::last_write_time(file, error);
  if (error) return "absent";
  const auto size = std::filesystem::file_size(file, error);
  {
    const std::lock_guard lock(mutex_);
    const auto known = hashes_.find(file.string());
    if (known != hashes_.end() && known->second.time == time && known->second.size == size)
      return known->second.sha256;
  }
  std::string sha256 = sha256_of_file(file);
  const std::lock_guard lock(mutex_);
  hashes_[file.string()] = {time, size, sha256};
  return sha256;
}

std::string ProductCache::key_of(const std::string& what, const std::vector<std::filesystem::path>& files) {
  std::vector<std::string> parts{program_version(), what};
  for (const std::filesystem::path& file : files) {
    // The log of SQLite exists while a program writes to the file.
    if (std::filesystem::exists(file.string() + "-wal")) return {};
    parts.push_back(file.filename().string());
    parts.push_back(hash_of(file));
  }
  return next_link("", parts);
}

std::shared_ptr<const Product> ProductCache::find(const std::string& key) {
  const std::lock_guard lock(mutex_);
  const auto found = places_.find(key);
  if (found == places_.end()) return nullptr;
  kept_.splice(kept_.begin(), kept_, found->second);
  return kept_.front().product;
}

void ProductCache::keep(const std::string& key, std::shared_ptr<const Product> product) {
  const std::lock_guard lock(mutex_);
  if (places_.contains(key) || product->body.size() > most_bytes_ / 2) return;
  bytes_ += product->body.size();
  kept_.push_front({key, std::move(product)});
  places_[key] = kept_.begin();
  while (bytes_ > most_bytes_) {
    bytes_ -= kept_.back().product->body.size();
    places_.erase(kept_.back().key);
    kept_.pop_back();
  }
}

}  // namespace abcal::console
