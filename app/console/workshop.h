#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/thread_pool.hpp>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <stop_token>
#include <string>
#include <vector>

namespace abcal::console {

/// A product that was made for a page.
struct Product {
  unsigned status = 200;
  std::string content_type;
  std::string body;
  bool is_file = false;  ///< For download, not for display.
};

/// No client waits for the product any more.
class Cancelled : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// @throws Cancelled
void require_wanted(const std::stop_token& cancelled);

/// The turn of an order.
struct Turn {
  /// Orders of one person that wait: a page that is being opened asks twice, and a person may have two pages.
  static constexpr int kMostWaiting = 3;
  /// The person that it is for. Of one person at most one order is made at a time, and the newest ones wait;
  /// those in between are answered with a refusal. Empty: it counts for nobody.
  std::string of{};
  bool first = false;  ///< It goes before waiting orders that are not.
};

/// Makes slow products in the threads of a pool: each once, however many clients wait for it, and given up if
/// none waits any more. Orders that wait for a thread begin in the order of their arrival, but for their
/// Turn. Its functions are for the thread of `io`.
class Workshop {
 public:
  using Make = std::function<std::shared_ptr<const Product>(const std::stop_token& cancelled)>;
  using Done = std::function<void(const std::shared_ptr<const Product>& product)>;
  /// A waiting client. Once it is destroyed, `done` is not called, and the work ends if nobody else waits.
  using Ticket = std::shared_ptr<void>;

  Workshop(boost::asio::io_context& io, std::size_t threads);
  ~Workshop() { close(); }
  Workshop(const Workshop&) = delete;
  Workshop& operator=(const Workshop&) = delete;

  /// @param name  orders of one name share one product; empty: not shared
  /// @param make  called in the pool; what it throws becomes an answer for people
  /// @param done  called in the thread of `io`
  /// @param turn  of the first client who orders the product
  Ticket order(const std::string& name, Make make, Done done, Turn turn = {});
  /// Cancels all, and waits for the end.
  void close();
  /// Number of waiting clients.
  std::size_t in_progress() const;

 private:
  struct Order;
  struct Book;
  std::shared_ptr<Book> book_;
  boost::asio::thread_pool pool_;
};

/// Keeps products made from files, by a hash of the files, the version of the program and the product's name.
/// The least recently used product is dropped first. Safe to use from several threads.
class ProductCache {
 public:
  explicit ProductCache(std::size_t most_bytes) : most_bytes_(most_bytes) {}

  /// @param what   "report.pdf"
  /// @param files  each as it is now; absence is a state as well
  /// @return empty: a file is being written, so that a product of it is not worth keeping
  std::string key_of(const std::string& what, const std::vector<std::filesystem::path>& files);
  /// The product of a key; null: it is not kept.
  std::shared_ptr<const Product> find(const std::string& key);
  void keep(const std::string& key, std::shared_ptr<const Product> product);

 private:
  struct Hashed {
    std::filesystem::file_time_type time;
    std::uintmax_t size = 0;
    std::string sha256;
  };
  struct Kept {
    std::string key;
    std::shared_ptr<const Product> product;
  };
  std::string hash_of(const std::filesystem::path& file);

  const std::size_t most_bytes_;
  std::mutex mutex_;
  std::map<std::string, Hashed> hashes_;  ///< By path: a file that has not changed is not read again.
  std::list<Kept> kept_;                  ///< Most recently used first.
  std::map<std::string, std::list<Kept>::iterator> places_;
  std::size_t bytes_ = 0;
};

}  // namespace abcal::console
