#include "drivers/wire/port_list.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <stdexcept>

#include "drivers/instrument/instrument_error.h"
#include "drivers/wire/open_stream.h"
#include "drivers/wire/port_held.h"
#include "tests/drivers/wire/pseudo_terminal.h"
#include "tests/drivers/wire/steady_clock.h"

namespace abcal::wire {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

PortInfo usb_port(const std::string& path, std::uint16_t vendor, std::uint16_t product,
                  const std::string& serial) {
  PortInfo port;
  port.path = path;
  port.usb_vendor = vendor;
  port.usb_product = product;
  port.serial_number = serial;
  return port;
}

const std::vector<PortInfo>& some_ports() {
  static const std::vector<PortInfo> ports = [] {
    std::vector<PortInfo> result{usb_port("/dev/ttyUSB0", 0x0403, 0x6001, "A1"),
                                 usb_port("/dev/ttyUSB1", 0x0403, 0x6001, "B:2"),
                                 usb_port("/dev/ttyACM0", 0x199b, 0x3065, "6251.1")};
    result.emplace_back().path = "/dev/ttyS0";
    return result;
  }();
  return ports;
}

std::string error_of(std::string_view port, const std::vector<PortInfo>& ports) {
  try {
    return "resolved to " + resolve_port(port, ports);
  } catch (const InstrumentError& error) {
    EXPECT_EQ(error.fault(), Fault::kCannotOpen);
    return error.what();
  }
}

TEST(PortListTest, AUsbNameFindsItsPath) {
  EXPECT_EQ(resolve_port("usb:199b:3065", some_ports()), "/dev/ttyACM0");
  EXPECT_EQ(resolve_port("usb:0x199B:0x3065:6251.1", some_ports()), "/dev/ttyACM0");
  EXPECT_EQ(resolve_port("usb:0403:6001:A1", some_ports()), "/dev/ttyUSB0");
  EXPECT_EQ(resolve_port("usb:0403:6001:B:2", some_ports()), "/dev/ttyUSB1");
}

TEST(PortListTest, OtherNamesStayAsTheyAre) {
  EXPECT_EQ(resolve_port("/dev/ttyUSB7", some_ports()), "/dev/ttyUSB7");
  EXPECT_EQ(resolve_port("bench/stage", some_ports()), "bench/stage");
  EXPECT_EQ(resolve_port("tcp:192.168.0.7:50000", some_ports()), "tcp:192.168.0.7:50000");
}

TEST(PortListTest, AnAmbiguousUsbNameListsTheCandidates) {
  EXPECT_THAT(
      error_of("usb:0403:6001", some_ports()),
      AllOf(HasSubstr("matches several ports"), HasSubstr("/dev/ttyUSB0 (usb:0403:6001:A1)"),
            HasSubstr("/dev/ttyUSB1"), Not(HasSubstr("ttyACM0")), HasSubstr("add the serial number")));
}

TEST(PortListTest, AnAbsentUsbNameListsWhatThereIs) {
  EXPECT_THAT(error_of("usb:0403:6001:C3", some_ports()),
              AllOf(HasSubstr("not connected"), HasSubstr("/dev/ttyUSB0 (usb:0403:6001:A1)"),
                    HasSubstr("/dev/ttyACM0 (usb:199b:3065:6251.1)"), Not(HasSubstr("ttyS0"))));
  EXPECT_THAT(error_of("usb:0403:6001", {}), HasSubstr("no USB serial port connected"));
}

TEST(PortListTest, NamesAreTakenApart) {
  const PortName tcp = parse_port("tcp:c884.lab:50000");
  EXPECT_EQ(tcp.kind, PortName::Kind::kTcp);
  EXPECT_EQ(tcp.host, "c884.lab");
  EXPECT_EQ(tcp.tcp_port, 50000);
  EXPECT_EQ(parse_port("tcp:[::1]:50000").host, "::1");
  EXPECT_EQ(parse_port("/dev/ttyUSB0").kind, PortName::Kind::kPath);
  for (const char* port : {"/dev/usbtmc3", "usbtmc:/dev/usbtmc3"}) {
    EXPECT_EQ(parse_port(port).kind, PortName::Kind::kUsbtmc);
    EXPECT_EQ(parse_port(port).path, "/dev/usbtmc3");
  }
  EXPECT_EQ(parse_port("usbtmc:/dev/voltmeter").kind, PortName::Kind::kUsbtmc);
}

TEST(PortListTest, ARawSocketMayHaveItsVisaName) {
  for (const char* port : {"TCPIP::192.168.0.20::5025::SOCKET", "TCPIP0::192.168.0.20::5025::SOCKET",
                           "tcpip::192.168.0.20::5025::socket"}) {
    EXPECT_EQ(parse_port(port).kind, PortName::Kind::kTcp);
    EXPECT_EQ(parse_port(port).host, "192.168.0.20");
    EXPECT_EQ(parse_port(port).tcp_port, 5025);
  }
}

TEST(PortListTest, OtherVisaNamesAreRefusedWithTheWayOut) {
  for (const std::string port :
       {"TCPIP::192.168.0.20::INSTR", "TCPIP0::192.168.0.20::inst0::INSTR", "TCPIP::meter::hislip0::INSTR",
        "GPIB0::22::INSTR", "USB0::0x2A8D::0x0101::MY1::INSTR", "TCPIPX::meter::5025::SOCKET"}) {
    try {
      parse_port(port);
      ADD_FAILURE() << port << " was accepted";
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), AllOf(HasSubstr("\"" + port + "\""), HasSubstr("raw SCPI socket"),
                                      HasSubstr("TCPIP::HOST::PORT::SOCKET")));
    }
  }
}

TEST(PortListTest, MalformedNamesSayWhatIsRequired) {
  for (const std::string port : {"",
                                 "COM3",
                                 "simulated",
                                 "usb:",
                                 "usb:0403",
                                 "usb:0403:",
                                 "usb:0403:6001:",
                                 "usb:xyzw:6001",
                                 "usb:10403:6001",
                                 "tcp:",
                                 "tcp:host",
                                 "tcp::50000",
                                 "tcp:host:",
                                 "tcp:host:0",
                                 "tcp:host:65536",
                                 "tcp:host:5x",
                                 "usbtmc:",
                                 "usbtmc:0",
                                 "TCPIP::host::0::SOCKET",
                                 "TCPIP::::5025::SOCKET"}) {
    try {
      parse_port(port);
      ADD_FAILURE() << port << " was accepted";
    } catch (const std::invalid_argument& error) {
      EXPECT_THAT(error.what(), AllOf(HasSubstr("\"" + port + "\""), HasSubstr("usb:VID:PID[:SERIAL]"),
                                      HasSubstr("usbtmc:/")));
    }
  }
}

TEST(PortListTest, ListsThePortsOfThisMachine) {
  for (const PortInfo& port : list_ports()) {  // None on most test machines: then only that it does not fail.
    EXPECT_THAT(port.path, HasSubstr("/dev/"));
    EXPECT_EQ(port.usb_vendor.has_value(), port.usb_product.has_value());
  }
}

TEST(PortListTest, TheHolderOfAPortIsFoundAndOneselfIsNone) {
  test::PseudoTerminal terminal;
  const int own = ::open(terminal.path().c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);
  ASSERT_GE(own, 0);
  EXPECT_EQ(find_holder(terminal.path()), "");
  std::array<int, 2> to_child{};
  ASSERT_EQ(::pipe2(to_child.data(), O_CLOEXEC), 0);
  const pid_t child = ::fork();  // Inherits the open port.
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::close(to_child[1]);
    char ignored = 0;
    ::_exit(::read(to_child[0], &ignored, 1) == 0 ? 0 : 1);
  }
  EXPECT_THAT(find_holder(terminal.path()),
              AllOf(HasSubstr("pid " + std::to_string(child)), HasSubstr("(wire_test)")));
  const std::vector<PortHolder> holders = find_holders(terminal.path());
  ASSERT_EQ(holders.size(), 1U);
  EXPECT_EQ(holders[0].pid, std::to_string(child));
  EXPECT_TRUE(PortHeld(terminal.path(), "held", holders).is_held_by("wire_test"));
  EXPECT_FALSE(PortHeld(terminal.path(), "held", holders).is_held_by("abcal-guard"));
  ::close(to_child[1]);
  int status = -1;
  EXPECT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_EQ(status, 0);
  ::close(to_child[0]);
  ::close(own);
  EXPECT_EQ(find_holder("/dev/no-such-port"), "");
}

TEST(PortListTest, APathIsOpenedByTheNameInABenchFile) {
  test::SteadyClock clock;
  test::PseudoTerminal terminal;
  const auto stream =
      open_stream(terminal.path(), {.path = "ignored", .baud = 9600, .rts_cts = false}, clock);
  stream->write("x");
  EXPECT_EQ(terminal.read(1), "x");
  EXPECT_THROW(open_stream("simulated", {}, clock), std::invalid_argument);
}

}  // namespace
}  // namespace abcal::wire
