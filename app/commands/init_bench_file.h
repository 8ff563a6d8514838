#pragma once

#include <array>
#include <optional>
#include <string>

#include "app/bench_file/item_identity.h"
#include "app/commands/init_answers.h"
#include "app/measure/session/learned_mounting.h"

namespace abcal {

/// Everything that `abcal init` writes into a bench file.
struct BenchDraft {
  std::string stage_name;  ///< Maker, model and serial number, for a comment.
  std::string stage_driver, stage_port;
  std::array<std::string, 2> axes{"1", "2"};  ///< The controller's names of X and Z.
  std::string accelerometer_name;
  std::string accelerometer_driver, accelerometer_port, response_unit;
  ItemNames item;                    ///< As the instrument reports it of the item itself.
  std::array<AxisTravel, 2> travel;  ///< As the controllers count.
  PlaceAnswer place;
  std::string operator_name;
  std::optional<LearnedMounting> learned;  ///< Absent: not turned yet; both signs are 1 then.
  std::string made;                        ///< Who made the file and when, for its first comment.
  std::string emulated;  ///< [protocol] and [simulation] of an emulated bench; empty: real instruments.
};

/// A travel as the controller counts, in protocol angles: controller angle = sign * protocol angle.
AxisTravel in_protocol_angles(const AxisTravel& travel, int sign);

/// The bench file, with comments that state the source of each value. parse_bench() reads it.
std::string bench_draft_text(const BenchDraft& draft);

}  // namespace abcal
