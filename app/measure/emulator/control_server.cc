#include "app/measure/emulator/control_server.h"

#include <fmt/format.h>

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read_until.hpp>
#include <boost/asio/streambuf.hpp>
#include <boost/asio/write.hpp>
#include <istream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <thread>
#include <utility>

#include "app/bench_file/bench_config.h"
#include "app/document/json_text.h"
#include "app/measure/bench/fault_schedule.h"
#include "drivers/wire/readable_bytes.h"

namespace abcal {
namespace {

using boost::asio::ip::tcp;
using Json = nlohmann::ordered_json;

constexpr std::size_t kLongestLine = 2 * 1024 * 1024;

Json axis_status(const sim::SimBench& world, StageAxis axis, Clock::Instant now) {
  return {{"commanded_deg", world.commanded_angle(axis, now).deg()},
          {"actual_deg", world.actual_angle(axis, now).deg()},
          {"moving", world.moving(axis, now)}};
}

Json chamber_status(const sim::SimBench& world, Clock::Instant now) {
  const sim::ChamberCommand command = world.commanded_chamber();
  return {{"target_degc", command.target_degc},
          {"running", command.running},
          {"paused", command.paused},
          {"air_degc", world.chamber_air(now)}};
}

}  // namespace

EmulatorControl::EmulatorControl(SimWorlds worlds, const Clock& clock,
                                 std::map<std::string, sim::FaultyStream*> links, Unserved unserved)
    : worlds_(std::move(worlds)),
      world_(*worlds_.front()),
      clock_(clock),
      links_(std::move(links)),
      unserved_(std::move(unserved)) {}

std::string EmulatorControl::answer(const std::string& line) {
  try {
    const Clock::Instant now = clock_.now();
    const double now_s = to_seconds(now - world_.start());
    Json request = Json::parse(line, nullptr, false);
    if (!request.is_object() || !request.contains("do") || !request["do"].is_string())
      throw std::invalid_argument(
          R"(found no JSON object with "do"; required: {"do": "status" | "fault" | "change" | "clear", ...})");
    const std::string action = request["do"];
    request.erase("do");
    if (action != "fault" && action != "change" && !request.empty())
      throw std::invalid_argument(fmt::format("\"{}\" has no key \"{}\"", action, request.begin().key()));
    // No at_s: takes effect immediately.
    if ((action == "fault" || action == "change") && !request.contains("at_s")) request["at_s"] = now_s;

    Json reply = {{"ok", true}, {"time_s", now_s}};
    if (action == "status") {
      reply["x"] = axis_status(world_, StageAxis::kX, now);
      reply["z"] = axis_status(world_, StageAxis::kZ, now);
      reply["temperature_degc"] = world_.temperature_degc(now);
      if (world_.chamber_in_use()) reply["chamber"] = chamber_status(world_, now);
      reply["faults"] = Json::array();
      const auto add = [&](sim::FaultKind kind, const std::string& where) {
        for (const sim::FaultDescription& d : sim::fault_descriptions())
          if (d.kind == kind) reply["faults"].push_back({{"kind", d.name}, {"where", where}});
      };
      for (std::size_t i = 0; i < worlds_.size(); ++i)
        for (const sim::WorldFault& fault : worlds_[i]->faults_at(now))
          add(fault.kind, worlds_.size() == 1 ? "world" : fmt::format("world of item {}", i + 1));
      for (const auto& [name, link] : links_)
        for (const sim::FaultKind kind : link->active()) add(kind, name);
      reply["unserved"] = Json::array();
      for (const auto& [name, commands] : unserved_)
        for (const sim::UnservedCommand& each : commands->all())
          reply["unserved"].push_back({{"instrument", name},
                                       {"command", each.command},
                                       {"bytes", wire::bytes_in_hex(each.bytes)},
                                       {"reaction", each.reaction},
                                       {"count", each.count}});
    } else if (action == "fault") {
      const FaultConfig fault = parse_fault(request);
      if (const auto of_the_world = world_fault(fault, world_.start())) {
        const auto item = item_of_instrument(fault.instrument);
        if (item && static_cast<std::size_t>(*item) > worlds_.size())
          throw std::invalid_argument(fmt::format("this bench has no \"{}\"", fault.instrument));
        for (std::size_t i = 0; i < worlds_.size(); ++i)
          if (!item || static_cast<std::size_t>(*item) == i + 1) worlds_[i]->inject(*of_the_world);
      } else {
        const auto link = links_.find(fault.instrument);
        if (link == links_.end())
          throw std::invalid_argument(fmt::format("this bench has no \"{}\"", fault.instrument));
        sim::WireFault of_the_wire = wire_fault(fault, world_.start()).value();
        // Commands are counted from now on, because a client does not know the number of earlier ones.
        if (of_the_wire.at_write) *of_the_wire.at_write += link->second->writes();
        link->second->add(std::move(of_the_wire));
      }
    } else if (action == "change") {
      std::size_t item = 1;
      if (request.contains("item") && request["item"].is_number_unsigned()) item = request["item"];
      request.erase("item");
      if (item < 1 || item > worlds_.size())
        throw std::invalid_argument(fmt::format("this bench has no item {}", item));
      sim::SimBench& world = *worlds_[item - 1];
      const ChangeConfig change = parse_change(request, world.output_truth(now));
      world.change(change.truth, world.start() + from_seconds(change.at_s));
    } else if (action == "clear") {
      for (const auto& world : worlds_) world->clear_faults(now);
      for (const auto& [name, link] : links_) link->clear();
    } else {
      throw std::invalid_argument(
          fmt::format("\"do\" is \"{}\"; required: status, fault, change or clear", action));
    }
    return reply.dump();
  } catch (const std::exception& error) {
    return json_text(Json{{"ok", false}, {"error", error.what()}});
  }
}

namespace {

/// One client: reads a line, writes its answer, and so on.
class Session : public std::enable_shared_from_this<Session> {
 public:
  Session(tcp::socket socket, EmulatorControl& control)
      : socket_(std::move(socket)), control_(control), input_(kLongestLine) {}

  void read() {
    boost::asio::async_read_until(socket_, input_, '\n',
                                  [self = shared_from_this()](boost::system::error_code error, std::size_t) {
                                    if (!error) self->reply();
                                  });
  }

 private:
  void reply() {
    std::istream lines(&input_);
    std::string line;
    std::getline(lines, line);
    output_ = control_.answer(line) + "\n";
    boost::asio::async_write(socket_, boost::asio::buffer(output_),
                             [self = shared_from_this()](boost::system::error_code error, std::size_t) {
                               if (!error) self->read();
                             });
  }

  tcp::socket socket_;
  EmulatorControl& control_;
  boost::asio::streambuf input_;
  std::string output_;
};

}  // namespace

struct ControlServer::Impl {
  Impl(EmulatorControl& the_control, std::uint16_t port)
      : control(the_control),
        acceptor(io, tcp::endpoint(boost::asio::ip::address_v4::loopback(), port)),
        port_number(acceptor.local_endpoint().port()) {
    accept();
    thread = std::jthread([this] { io.run(); });
  }

  void accept() {
    acceptor.async_accept([this](boost::system::error_code error, tcp::socket socket) {
      if (error) return;
      std::make_shared<Session>(std::move(socket), control)->read();
      accept();
    });
  }

  EmulatorControl& control;
  boost::asio::io_context io;
  tcp::acceptor acceptor;
  std::uint16_t port_number;
  std::jthread thread;
};

ControlServer::ControlServer(EmulatorControl& control, std::uint16_t port) try
    : impl_(std::make_unique<Impl>(control, port)) {
} catch (const boost::system::system_error& error) {
  throw std::runtime_error(
      fmt::format("--control {}: the port cannot be opened: {}", port, error.code().message()));
}

ControlServer::~ControlServer() {
  impl_->io.stop();
}

std::uint16_t ControlServer::port() const {
  return impl_->port_number;
}

}  // namespace abcal
