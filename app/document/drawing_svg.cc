#include "app/document/drawing_svg.h"

#include <fmt/format.h>

#include <new>
#include <variant>

#include "app/document/valid_text.h"
#include "app/formats/xml_tree.h"

namespace abcal {
namespace {

void set(xmlNode* node, const char* name, const std::string& value) {
  xmlNewProp(node, as_xml(name), as_xml(valid_text(value).c_str()));
}

xmlNode* add(xmlNode* parent, const char* name, const std::string& text = {}) {
  xmlNode* node = xmlNewChild(parent, nullptr, as_xml(name), nullptr);
  if (node == nullptr) throw std::bad_alloc();
  if (!text.empty()) xmlAddChild(node, xmlNewDocText(parent->doc, as_xml(valid_text(text).c_str())));
  return node;
}

void draw(xmlNode* svg, const PicturePath& path) {
  std::string outline;
  for (const std::vector<PicturePoint>& line : path.lines) {
    char command = 'M';
    for (const auto& [x, y] : line) {
      outline += fmt::format("{}{:.6g},{:.6g}", command, x, y);
      command = 'L';
    }
    if (!path.fill.empty()) outline += 'z';
  }
  xmlNode* node = add(svg, "path");
  set(node, "d", outline);
  set(node, "fill", path.fill.empty() ? "none" : path.fill);
  if (path.opacity < 1.0) set(node, "fill-opacity", fmt::format("{:g}", path.opacity));
  if (path.stroke.empty()) return;
  set(node, "stroke", path.stroke);
  set(node, "stroke-width", fmt::format("{:g}", path.width));
}

void draw(xmlNode* svg, const PictureLabel& label) {
  xmlNode* node = add(svg, "text", label.text);
  const std::string x = fmt::format("{:.6g}", label.at[0]), y = fmt::format("{:.6g}", label.at[1]);
  set(node, "x", x);
  set(node, "y", y);
  set(node, "fill", label.colour);
  set(node, "font-size", fmt::format("{:g}", label.size));
  set(node, "text-anchor", label.alignment < 0.5 ? "start" : label.alignment > 0.5 ? "end" : "middle");
  if (label.upwards) set(node, "transform", fmt::format("rotate(-90 {} {})", x, y));
}

}  // namespace

void add_svg(xmlNode* parent, const Drawing& drawing, const std::string& description) {
  xmlNode* svg = add(parent, "svg");
  xmlSetNs(svg, xmlNewNs(svg, as_xml("http://www.w3.org/2000/svg"), nullptr));
  set(svg, "width", fmt::format("{:g}", kPictureWidth));
  set(svg, "height", fmt::format("{:g}", drawing.height));
  set(svg, "viewBox", fmt::format("0 0 {:g} {:g}", kPictureWidth, drawing.height));
  set(svg, "font-family", "\"DejaVu Sans\", \"Liberation Sans\", Arial, sans-serif");
  set(svg, "role", "img");
  set(svg, "aria-label", description);
  for (const auto& element : drawing.elements)
    std::visit([&](const auto& each) { draw(svg, each); }, element);
}

std::string svg_file(const Drawing& drawing, const std::string& description) {
  const XmlDocument document(xmlNewDoc(as_xml("1.0")));
  if (!document) throw std::bad_alloc();
  // The picture is the only child of this node, and becomes the root.
  xmlNode* holder = xmlNewDocNode(document.get(), nullptr, as_xml("holder"), nullptr);
  xmlDocSetRootElement(document.get(), holder);
  add_svg(holder, drawing, description);
  xmlNode* svg = holder->children;
  xmlUnlinkNode(svg);
  xmlDocSetRootElement(document.get(), svg);
  xmlFreeNode(holder);
  return xml_text(document);
}

}  // namespace abcal
