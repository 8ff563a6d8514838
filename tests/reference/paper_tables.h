#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>

#include "drivers/instrument/angle.h"
#include "protocol/model/alignment.h"

/// Numbers printed in Geist & Gaitan, J. Res. NIST 126, 126038 (2021), and in docs/theory/abc_protocol.md
/// where the print is known to slip. Each with its last printed digit.
namespace abcal::reference {

/// sin(0.008 degrees), the paper's standard uncertainty of Zx, Zy, Xz.
inline double q() {
  return sincos(Angle::degrees(0.008)).sin;
}

/// Table 2: the first AUT of Simulation Set 2, 15 decimals.
inline Eigen::Matrix3d table2_sensitivity() {
  Eigen::Matrix3d s;
  s << 1.084557444843417, -0.047097516966133, 0.037216463393415,  //
      0.369246379560599, 0.920196068359764, 0.285771705579544,    //
      -0.117336380485872, 0.263805007662141, 0.819879210182046;
  return s;
}
inline Eigen::Vector3d table2_offset() {
  return {0.053766713954610, 0.183388501459509, -0.225884686100365};
}
inline Eigen::Vector3d table2_intrinsic_sensitivity() {
  return {1.086217332036812, 1.031876523985898, 0.869231170369473};
}
inline Eigen::Vector3d table2_intrinsic_angle_deg() {
  return {70.845583191199623, 61.081782813884068, 96.639644038935558};
}

/// A number as printed, with `digits` decimals of its mantissa ("-9.748e-09" has 3). Below 1e-14 the print is
/// round-off.
struct Printed {
  double value = 0.0;
  int digits = 3;

  /// Half of the last printed digit; for round-off entries the bound that docs/theory/abc_protocol.md states.
  double tolerance() const {
    if (std::abs(value) < 1e-14) return 1e-14;
    return 0.5 * std::pow(10.0, std::floor(std::log10(std::abs(value))) - digits);
  }
  double expected() const { return std::abs(value) < 1e-14 ? 0.0 : value; }
};

/// Errors (result minus truth) printed for one case: s row by row, intrinsic s, O, phi (degree).
struct ErrorTable {
  const char* name;
  const char* file;   ///< Readings that give it, under abc/ of the shared data; empty: none.
  bool ideal_aut;     ///< Identity and no offset, else Table 2.
  double zx, zy, xz;  ///< In units of q.
  std::array<Printed, 9> s;
  std::array<Printed, 3> intrinsic;
  std::array<Printed, 3> offset;
  std::array<Printed, 3> angle_deg;
};

inline const std::array<ErrorTable, 5>& error_tables() {
  static const std::array<ErrorTable, 5> tables{{
      {"Table 5",
       "table5.csv",
       true,
       0,
       0,
       1,
       {{{-9.748e-09},
         {-6.981e-05},
         {-6.981e-05},
         {6.981e-05},
         {-9.748e-09},
         {-6.981e-05},
         {0},
         {0},
         {-1.950e-08}}},
       {{{-4.874e-09}, {-4.874e-09}, {-1.950e-08}}},
       {{{4.654e-05}, {4.654e-05}, {1.950e-08}}},
       {{{-2.793e-07}, {4.000e-03}, {4.000e-03}}}},
      {"Table 6",
       "table6.csv",
       false,
       0,
       0,
       1,
       {{{-3.299e-06},
         {-7.572e-05},
         {-7.243e-05},
         {6.424e-05},
         {-2.579e-05},
         {-9.003e-05},
         {1.842e-05},
         {8.189e-06},
         {-1.024e-05}}},
       {{{-2.487e-06}, {-2.494e-05}, {-9.661e-06}}},
       {{{4.829e-05}, {6.002e-05}, {6.833e-06}}},
       {{{7.748e-04}, {4.484e-03}, {3.740e-03}}}},
      {"Table 7",
       "table7.csv",
       true,
       1,
       1,
       0,
       {{{0}, {0}, {1.396e-04}, {1.950e-08}, {0}, {0}, {-2.094e-04}, {-6.981e-05}, {0}}},
       {{{-9.748e-09}, {0}, {-1.462e-08}}},
       {{{0}, {0}, {-4.654e-05}}},
       {{{0}, {4.000e-03}, {4.000e-03}}}},
      {"Set 6 as its text says (Xz = 0)",
       "",
       false,
       1,
       1,
       0,
       {{{-7.796e-06},
         {-2.598e-06},
         {1.514e-04},
         {-5.983e-05},
         {-1.995e-05},
         {5.156e-05},
         {-1.717e-04},
         {-5.724e-05},
         {-1.638e-05}}},
       {{{-2.492e-06}, {-2.493e-05}, {-9.656e-06}}},
       {{{-1.732e-06}, {-1.330e-05}, {-3.816e-05}}},
       {{{7.75e-04, 2}, {4.484e-03}, {3.740e-03}}}},
      {"Table 8 as printed (Xz = 0.91434 q, rows s and O put right)",
       "",
       false,
       1,
       1,
       0.91434,
       {{{-1.081e-05},
         {-7.183e-05},
         {8.521e-05},
         {-1.098e-06},
         {-4.353e-05},
         {-3.076e-05},
         {-1.549e-04},
         {-4.975e-05},
         {-2.576e-05}}},
       {{{-4.766e-06}, {-4.773e-05}, {-1.850e-05}}},
       {{{4.242e-05}, {4.158e-05}, {-3.190e-05}}},
       {{{1.484e-03}, {8.584e-03}, {7.161e-03}}}},
  }};
  return tables;
}

inline Alignment alignment_of(const ErrorTable& table) {
  return {table.zx * q(), table.zy * q(), table.xz * q()};
}

inline Eigen::Matrix3d platter_sensitivity_of(const ErrorTable& table) {
  return table.ideal_aut ? Eigen::Matrix3d(Eigen::Matrix3d::Identity()) : table2_sensitivity();
}
inline Eigen::Vector3d offset_of(const ErrorTable& table) {
  return table.ideal_aut ? Eigen::Vector3d(Eigen::Vector3d::Zero()) : table2_offset();
}

}  // namespace abcal::reference
