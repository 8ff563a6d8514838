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

/// What was made for a page.
struct Product {
  unsigned status = 200;
  std::string content_type;
  std::string body;
  bool is_file = false;  ///< To be kept, not to be shown.
};

/// Nobody waits for it any more.
class Cancelled : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// @throws Cancelled
void require_wanted(const std::stop_token& cancelled);

/// Makes what takes its time, in the threads of a pool: once, however many wait for it, and not to its end if
/// nobody does any more. Its functions are for the thread of `io`.
class Workshop {
 public:
  using Make = std::function<std::shared_ptr<const Product>(const std::stop_token& cancelled)>;
  using Done = std::function<void(const std::shared_ptr<const Product>& product)>;
  /// Who waits. When it is destroyed, nothing is told, and the work ends if nobody else waits for it.
  using Ticket = std::shared_ptr<void>;

  Workshop(boost::asio::io_context& io, std::size_t threads);
  ~Workshop() { close(); }
  Workshop(const Workshop&) = delete;
  Workshop& operator=(const Workshop&) = delete;

  /// @param name  orders of one name get one product; empty: it is of nobody else
  /// @param make  called in the pool; what it throws becomes an answer for people
  /// @param done  called in the thread of `io`
  Ticket order(const std::string& name, Make make, Done done);
  /// Cancels all, and waits for the end.
  void close();
  /// Orders that somebody waits for.
  std::size_t in_progress() const;

 private:
  struct Order;
  struct Book;
  boost::asio::io_context& io_;
  std::shared_ptr<Book> book_;
  boost::asio::thread_pool pool_;
};

/// Keeps what was made of files, by the hash of their bytes, of the program and of what it is. What was not
/// asked for longest goes first. Safe to use from several threads.
class ProductCache {
 public:
  explicit ProductCache(std::size_t most_bytes) : most_bytes_(most_bytes) {}

  /// @param what   "report.pdf"
  /// @param files  each as it is now; one that is not there is a state as well
  /// @return empty: a file is just being written, and nothing made of it is worth keeping
  std::string key_of(const std::string& what, const std::vector<std::filesystem::path>& files);
  /// Null: it is not kept.
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
  std::list<Kept> kept_;                  ///< The latest first.
  std::map<std::string, std::list<Kept>::iterator> places_;
  std::size_t bytes_ = 0;
};

}  // namespace abcal::console
