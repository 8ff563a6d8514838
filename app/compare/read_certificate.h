#pragma once

#include <filesystem>

#include "app/compare/compared_result.h"

namespace abcal {

/// Reads matrix, offsets and intrinsic properties with their uncertainties from a digital calibration
/// certificate (DCC 3): lists of numbers are known by their labels (s_ux ... s_wz, s_u, phi_uv, O_u). What is
/// not given is computed from what is, or stays NaN. Nothing is loaded from the network and no entity is
/// expanded.
/// @throws std::runtime_error not XML, not a certificate, no numbers of an accelerometer in it, or numbers
/// and
///         units that cannot be read; every problem of the file at once
ComparedResult read_certificate(const std::filesystem::path& path);

}  // namespace abcal
