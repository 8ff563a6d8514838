#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "app/bench_file/bench_config.h"
#include "app/commands/emulation.h"
#include "app/measure/bench/probe_ports.h"

namespace abcal {

/// The stage of an emulated bench, as an answer in place of a port.
inline constexpr const char* kEmulated = "emulated";

/// The two instruments of a new bench: found on the ports and chosen by a person, or emulated as long as this
/// lives.
class Instruments {
 public:
  /// Lists the ports and asks them which instruments are there, those given or all. Nothing moves.
  /// @param stage, item  answers given as options; an empty one is asked for, and filled
  /// @param folder       of the links of an emulated bench
  /// @throws RunInterrupted
  Instruments(std::string& stage, std::string& item, std::filesystem::path folder);
  Instruments(const Instruments&) = delete;
  Instruments& operator=(const Instruments&) = delete;
  ~Instruments();

  /// Each asks the person, if the answer was not given; the stage first.
  /// @throws RunInterrupted; InstrumentError, std::invalid_argument for a given answer that cannot be used
  ProbeAnswer stage();
  ProbeAnswer item();

  // As a bench file names them best.
  std::string stage_port() const;
  std::string item_port() const;

  bool are_emulated() const { return emulation_ != nullptr; }
  /// Folder of the links of an emulated bench; gone, if empty, when this ends.
  const std::filesystem::path& folder() const { return folder_; }

 private:
  Probed at_port(const std::vector<Probed>& list, const std::string& answer, std::string_view role);
  Probed emulated_stage();

  std::string& stage_answer_;
  std::string& item_answer_;
  std::filesystem::path folder_;
  std::vector<wire::PortInfo> listed_;
  std::vector<Probed> probed_;
  BenchConfig emulated_;
  std::unique_ptr<Emulation> emulation_;
  std::string stage_port_, item_port_;
};

}  // namespace abcal
