#pragma once

#include <libxml/tree.h>

#include <string>

#include "app/document/drawing.h"

namespace abcal {

/// Adds the picture as an <svg> to an element of a page: without ids, references and scripts.
/// @param description  for readers who do not see it
/// @throws std::bad_alloc
void add_svg(xmlNode* parent, const Drawing& drawing, const std::string& description);

/// The picture as a file of its own.
/// @throws std::bad_alloc
std::string svg_file(const Drawing& drawing, const std::string& description);

}  // namespace abcal
