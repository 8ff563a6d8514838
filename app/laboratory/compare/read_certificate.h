#pragma once

#include <filesystem>

#include "app/laboratory/compare/compared_result.h"

namespace abcal {

/// Reads matrix, offsets and intrinsic properties with their uncertainties from a digital calibration
/// certificate (DCC 3): lists of numbers are recognised by their labels (s_ux ... s_wz, s_u, phi_uv, O_u).
/// Missing values are computed from the others, or stay NaN. Nothing is loaded from the network and no entity
/// is expanded.
/// @throws std::runtime_error not XML, not a certificate, no numbers of an accelerometer in it, or numbers
/// and
///         units that cannot be read; all problems of the file at once
ComparedResult read_certificate(const std::filesystem::path& path);

}  // namespace abcal
