#include "app/document/packed_document.h"

#include <cstddef>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>
#include <variant>

// In a namespace with a name, as the specialisations below have external linkage.
namespace abcal::packing {

/// Converts a variant to [number of the alternative, value], for nlohmann's library.
template <class Variant>
struct NumberAndValue;
template <class... Alternatives>
struct NumberAndValue<std::variant<Alternatives...>> {
  using Variant = std::variant<Alternatives...>;

  static void to_json(nlohmann::json& to, const Variant& from) {
    std::visit([&](const auto& each) { to = nlohmann::json::array({from.index(), each}); }, from);
  }
  static void from_json(const nlohmann::json& from, Variant& to) {
    std::size_t number = 0;
    const auto index = from.at(0).get<std::size_t>();
    const auto take = [&]<class Alternative>(const Alternative*) {
      if (number++ == index) to = from.at(1).get<Alternative>();
    };
    (take(static_cast<const Alternatives*>(nullptr)), ...);
  }
};

using PictureElement = decltype(Drawing::elements)::value_type;

}  // namespace abcal::packing

template <>
struct nlohmann::adl_serializer<abcal::Block> : abcal::packing::NumberAndValue<abcal::Block> {};
template <>
struct nlohmann::adl_serializer<abcal::packing::PictureElement>
    : abcal::packing::NumberAndValue<abcal::packing::PictureElement> {};

namespace abcal {

NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(PicturePath, lines, stroke, width, fill, opacity)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(PictureLabel, text, at, alignment, size, colour, upwards)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Drawing, height, elements)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Paragraph, text)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(BulletList, items)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(FactList, facts)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(SideBySide, left, right)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Column, heading, kind)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(DocumentTable, caption, columns, rows, caption_kind, may_break, dense)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Figure, caption, drawing)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Section, title, blocks, on_new_page)
NLOHMANN_DEFINE_TYPE_NON_INTRUSIVE(Document, language, page_words, figure_words, title, subtitle,
                                   identification, origin, created_utc, cautions, page_mark, sections)

std::string packed(const Document& document) {
  std::string bytes;
  nlohmann::json::to_cbor(nlohmann::json(document), bytes);
  return bytes;
}

Document unpacked(std::string_view bytes) {
  try {
    return nlohmann::json::from_cbor(bytes).get<Document>();
  } catch (const nlohmann::json::exception& error) {
    throw std::runtime_error(std::string("no document: ") + error.what());
  }
}

}  // namespace abcal
