#pragma once

#include <Eigen/Core>
#include <string>

#include "app/document/document.h"

namespace abcal {

/// Words in the drawing of a mounting, in the language of the document.
struct MountingWords {
  std::string caption;
  std::string platter = "platter";
  std::string up = "up";
  /// Words with the surface on which the item stands and with its marks; empty: not stated.
  std::string surface = {}, marks = {};
};

/// Drawing of an item on the platter at the default orientation: the axes x, y, z of the platter, the item as
/// a block, and u, v, w where the stated mounting has them.
/// @param directions  rows: the directions of u, v, w in x, y, z (mounting_matrix())
Figure mounting_figure(const Eigen::Matrix3d& directions, const MountingWords& words);

}  // namespace abcal
