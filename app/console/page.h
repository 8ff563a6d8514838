#pragma once

#include <boost/beast/core.hpp>
#include <boost/beast/websocket.hpp>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>

#include "app/console/asker.h"
#include "app/console/http_exchange.h"
#include "app/console/persons.h"
#include "app/console/request.h"
#include "app/console/server_common.h"
#include "app/console/stream.h"

namespace abcal::console {

class Control;

/// A page that watches, over its WebSocket. Writes one message at a time; the queue of waiting messages is
/// bounded. For the thread of the connections.
class Page : public std::enable_shared_from_this<Page> {
 public:
  /// The visitor at the other end.
  struct Owner {
    Peer peer;
    Visitor visitor;
    std::shared_ptr<void> seat;
  };

  Page(Control& control, ServerCommon& common, Stream stream, Owner owner);
  Page(const Page&) = delete;
  Page& operator=(const Page&) = delete;

  const Peer& peer() const { return owner_.peer; }
  const Visitor& visitor() const { return owner_.visitor; }
  Asker asker() const;
  std::int64_t number = 0;
  Clock::Instant heard{};           ///< Time of its last message.
  bool waits_for_snapshot = false;  ///< Messages of the bench are withheld until then.

  /// Accepts the WebSocket, and joins the pages that watch.
  void open(const HttpRequest& request);
  /// Sends an event to the page; dropped if the page is too slow.
  void send(const SharedText& message);
  /// Answers a request of the page; never dropped.
  void reply(std::string message);
  void close();

 private:
  struct Waiting {
    SharedText text;
    bool is_reply;
  };
  void push(Waiting message);
  void read();
  void write();

  Control& control_;
  ServerCommon& common_;
  boost::beast::websocket::stream<Stream> socket_;
  Owner owner_;
  boost::beast::flat_buffer buffer_{kLongestRequest};
  std::deque<Waiting> queue_;
  Waiting now_{};            ///< Message being written.
  std::size_t replies_ = 0;  ///< Number of replies not yet written.
  bool paused_ = false;      ///< Nothing is read until replies are sent.
  bool writing_ = false;
  bool behind_ = false;
};

}  // namespace abcal::console
