#include "app/console/other_benches.h"

#include <algorithm>
#include <boost/asio/io_context.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>

#include "app/console/bench_channel.h"
#include "app/console/bench_service.h"
#include "app/system/channel.h"

namespace abcal::console {
namespace {

using Json = nlohmann::ordered_json;

/// The whole state of a bench, asked for over its socket. Null if it does not answer in time; nullopt if no
/// process listens there.
std::optional<Json> snapshot_of(const std::filesystem::path& socket, std::chrono::milliseconds patience) {
  Descriptor connected;
  try {
    connected = connect_to(socket, ChannelKind::kBytes);
  } catch (const std::system_error&) {
    return std::nullopt;
  }
  boost::asio::io_context io;
  Json snapshot;
  const auto channel = std::make_shared<BenchChannel>(io, std::move(connected));
  channel->begin(
      [&](std::string_view line) {
        if (line[0] != bench_line::kSnapshot) return;
        snapshot = Json::parse(line.substr(1), nullptr, /*allow_exceptions=*/false);
        channel->close();
      },
      [] {});
  channel->send(bench_line::kAskSnapshot);
  io.run_for(patience);
  channel->close();
  io.restart();
  io.poll();  // Handlers of the closed socket end here, before the objects that they use.
  return snapshot.is_discarded() ? Json() : snapshot;
}

Json tile_of(const std::filesystem::path& socket, std::chrono::milliseconds patience) {
  Json tile = {{"bench", *bench_of_socket(socket.filename().string())},
               {"folder", std::filesystem::absolute(socket.parent_path()).lexically_normal().string()}};
  const auto snapshot = snapshot_of(socket, patience);
  tile["state"] = !snapshot ? "not running" : snapshot->is_object() ? "answers" : "silent";
  if (tile["state"] != "answers") return tile;
  tile["activity"] = snapshot->value("activity", Json::object());
  for (const char* key : {"phase", "fault"}) tile[key] = snapshot->value(key, Json());
  const Json run = snapshot->value("run", Json());
  if (run.is_object())
    for (const char* key : {"file", "item", "simulated", "progress", "ended"})
      tile[key] = run.value(key, Json());
  return tile;
}

}  // namespace

Json other_benches(const std::vector<std::filesystem::path>& folders, std::chrono::milliseconds patience) {
  std::vector<std::filesystem::path> sockets;
  for (const std::filesystem::path& folder : folders) {
    std::error_code error;
    for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end;
         at.increment(error)) {
      std::error_code ignored;
      if (bench_of_socket(at->path().filename().string()) &&
          std::filesystem::is_socket(at->symlink_status(ignored)))
        sockets.push_back(at->path());
    }
  }
  std::ranges::sort(sockets);
  Json tiles = Json::array();
  for (const std::filesystem::path& socket : sockets) tiles.push_back(tile_of(socket, patience));
  return tiles;
}

}  // namespace abcal::console
