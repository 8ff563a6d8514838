#pragma once

#include <Eigen/Core>
#include <span>

#include "protocol/estimators/shared/noise_process.h"

namespace abcal {

// The loops in which a fit with a noise process spends its time, on the widest vectors of this machine.
// Sums run in the order of the rows and no operation is fused, so every processor gives the same bits.

/// Rows of three readings at a time, in place: the whitening filter of noise_process.h.
void whiten_rows(std::span<const WhitenerStep> steps, bool white, ReadingRows& rows);

/// X' X, both triangles.
Eigen::MatrixXd products_of_columns(const ReadingRows& rows);

/// X M.
ReadingRows times(const ReadingRows& rows, const Eigen::MatrixXd& matrix);
/// X R with R upper triangular; elements below its diagonal are not read.
ReadingRows times_upper(const ReadingRows& rows, const Eigen::MatrixXd& upper);

}  // namespace abcal
