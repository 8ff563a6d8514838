#include "app/document/pdf_archive.h"

#include <fmt/format.h>
#include <lcms2.h>
#include <libxml/entities.h>

#include <algorithm>
#include <fstream>
#include <memory>
#include <qpdf/Buffer.hh>
#include <qpdf/QPDF.hh>
#include <qpdf/QPDFEFStreamObjectHelper.hh>
#include <qpdf/QPDFEmbeddedFileDocumentHelper.hh>
#include <qpdf/QPDFFileSpecObjectHelper.hh>
#include <qpdf/QPDFPageDocumentHelper.hh>
#include <qpdf/QPDFWriter.hh>
#include <sstream>
#include <stdexcept>
#include <string>

#include "app/formats/xml_tree.h"

namespace abcal {
namespace {

/// The bytes of an sRGB profile, by Little CMS.
std::string srgb_profile() {
  const std::unique_ptr<void, int (*)(void*)> profile(cmsCreate_sRGBProfile(), cmsCloseProfile);
  cmsUInt32Number size = 0;
  if (!profile || cmsSaveProfileToMem(profile.get(), nullptr, &size) == 0)
    throw std::runtime_error("the colour profile of the PDF cannot be made");
  std::string bytes(size, '\0');
  if (cmsSaveProfileToMem(profile.get(), bytes.data(), &size) == 0)
    throw std::runtime_error("the colour profile of the PDF cannot be made");
  // Its date would differ each time: year, month, day, hour, minute, second (ICC.1, 7.2.8).
  constexpr std::size_t kDate = 24;
  constexpr std::string_view kFixed("\x07\xe8\0\x01\0\x01\0\0\0\0\0\0", 12);
  std::copy(kFixed.begin(), kFixed.end(), bytes.begin() + kDate);
  return bytes;
}

std::string escaped(const std::string& text) {
  const std::unique_ptr<xmlChar, decltype(xmlFree)> safe(
      xmlEncodeSpecialChars(nullptr, as_xml(xml_safe(text).c_str())), xmlFree);
  return reinterpret_cast<const char*>(safe.get());
}

/// The identification of PDF/UA-1. PDF/A requires a description of its schema.
constexpr const char* kPdfUa = R"(<pdfuaid:part>1</pdfuaid:part>
<pdfaExtension:schemas><rdf:Bag><rdf:li rdf:parseType="Resource">
<pdfaSchema:namespaceURI>http://www.aiim.org/pdfua/ns/id/</pdfaSchema:namespaceURI>
<pdfaSchema:prefix>pdfuaid</pdfaSchema:prefix>
<pdfaSchema:schema>PDF/UA identification schema</pdfaSchema:schema>
<pdfaSchema:property><rdf:Seq><rdf:li rdf:parseType="Resource">
<pdfaProperty:category>internal</pdfaProperty:category>
<pdfaProperty:description>Part of ISO 14289</pdfaProperty:description>
<pdfaProperty:name>part</pdfaProperty:name>
<pdfaProperty:valueType>Integer</pdfaProperty:valueType>
</rdf:li></rdf:Seq></pdfaSchema:property>
</rdf:li></rdf:Bag></pdfaExtension:schemas>)";

/// XMP metadata (ISO 16684-1).
/// @param more  further properties, as XML
std::string metadata(const std::string& title, const std::string& producer, const std::string& more) {
  return fmt::format(R"(<?xpacket begin="{}" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/">
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:dc="http://purl.org/dc/elements/1.1/" xmlns:pdf="http://ns.adobe.com/pdf/1.3/"
 xmlns:xmp="http://ns.adobe.com/xap/1.0/"
 xmlns:pdfaid="http://www.aiim.org/pdfa/ns/id/" xmlns:pdfuaid="http://www.aiim.org/pdfua/ns/id/"
 xmlns:pdfaExtension="http://www.aiim.org/pdfa/ns/extension/" xmlns:pdfaSchema="http://www.aiim.org/pdfa/ns/schema#"
 xmlns:pdfaProperty="http://www.aiim.org/pdfa/ns/property#">
<dc:title><rdf:Alt><rdf:li xml:lang="x-default">{}</rdf:li></rdf:Alt></dc:title>
<pdf:Producer>{}</pdf:Producer>
<pdfaid:part>3</pdfaid:part>
<pdfaid:conformance>B</pdfaid:conformance>
{}
</rdf:Description>
</rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>)",
                     "\xEF\xBB\xBF", escaped(title), escaped(producer), more);
}

void add_output_intent(QPDF& pdf) {
  QPDFObjectHandle profile = QPDFObjectHandle::newStream(&pdf, srgb_profile());
  profile.getDict().replaceKey("/N", QPDFObjectHandle::newInteger(3));
  QPDFObjectHandle intent = QPDFObjectHandle::newDictionary();
  intent.replaceKey("/Type", QPDFObjectHandle::newName("/OutputIntent"));
  intent.replaceKey("/S", QPDFObjectHandle::newName("/GTS_PDFA1"));
  intent.replaceKey("/OutputConditionIdentifier", QPDFObjectHandle::newString("sRGB IEC61966-2.1"));
  intent.replaceKey("/Info", QPDFObjectHandle::newString("sRGB IEC61966-2.1"));
  intent.replaceKey("/DestOutputProfile", profile);
  pdf.getRoot().replaceKey("/OutputIntents", QPDFObjectHandle::newArray({pdf.makeIndirectObject(intent)}));
}

/// Moves title and producer from the information dictionary, which may be absent, to the metadata.
void add_metadata(QPDF& pdf, const std::string& more) {
  QPDFObjectHandle info = pdf.getTrailer().getKey("/Info");
  const auto said = [&](const std::string& key) {
    return info.isDictionary() && info.getKey(key).isString() ? info.getKey(key).getUTF8Value()
                                                              : std::string();
  };
  QPDFObjectHandle stream = QPDFObjectHandle::newStream(
      &pdf, metadata(said("/Title"), said("/Producer") + ", qpdf " + QPDF::QPDFVersion(), more));
  stream.getDict().replaceKey("/Type", QPDFObjectHandle::newName("/Metadata"));
  stream.getDict().replaceKey("/Subtype", QPDFObjectHandle::newName("/XML"));
  pdf.getRoot().replaceKey("/Metadata", stream);
  pdf.getTrailer().removeKey("/Info");
}

void add_attachment(QPDF& pdf, const Attachment& attachment) {
  std::ostringstream bytes;
  bytes << std::ifstream(attachment.file, std::ios::binary).rdbuf();
  const std::string name = attachment.file.filename().string();
  const bool is_xml = attachment.file.extension() == ".xml";
  auto stream = QPDFEFStreamObjectHelper::createEFStream(pdf, bytes.str());
  stream.setSubtype(is_xml ? "text/xml" : "application/octet-stream");
  // The standard requires a date; a fixed one keeps the output the same for the same file.
  stream.setModDate("D:20240101000000Z");
  auto file = QPDFFileSpecObjectHelper::createFileSpec(pdf, name, stream);
  const bool is_data = attachment.kind == AttachmentKind::kData;
  file.setDescription(is_data ? "Digital calibration certificate (XML), of which these pages were made"
                              : "Attached file");
  file.getObjectHandle().replaceKey("/AFRelationship",
                                    QPDFObjectHandle::newName(is_data ? "/Data" : "/Supplement"));
  QPDFEmbeddedFileDocumentHelper(pdf).replaceEmbeddedFile(name, file);
  pdf.getRoot().replaceKey("/AF", QPDFObjectHandle::newArray({file.getObjectHandle()}));
}

/// Adds what an element of the structure, and those in it, lack.
/// @param figures, next  descriptions of the figures, and which comes next
void describe(QPDFObjectHandle element, const std::vector<std::string>& figures, std::size_t& next) {
  if (element.isArray())
    for (QPDFObjectHandle& each : element.getArrayAsVector()) describe(each, figures, next);
  if (!element.isDictionary() || !element.hasKey("/S")) return;
  const std::string name = element.getKey("/S").getName();
  if (name == "/Figure" && next < figures.size())
    element.replaceKey("/Alt", QPDFObjectHandle::newUnicodeString(xml_safe(figures[next++])));
  if (name == "/TH") {
    QPDFObjectHandle attributes = QPDFObjectHandle::newDictionary();
    attributes.replaceKey("/O", QPDFObjectHandle::newName("/Table"));
    attributes.replaceKey("/Scope", QPDFObjectHandle::newName("/Column"));
    element.replaceKey("/A", attributes);
  }
  describe(element.getKey("/K"), figures, next);
}

void add_description(QPDF& pdf, const PdfDescription& description) {
  QPDFObjectHandle root = pdf.getRoot();
  root.replaceKey("/Lang", QPDFObjectHandle::newUnicodeString(description.language));
  QPDFObjectHandle preferences = QPDFObjectHandle::newDictionary();
  preferences.replaceKey("/DisplayDocTitle", QPDFObjectHandle::newBool(true));
  root.replaceKey("/ViewerPreferences", preferences);
  std::size_t next = 0;
  describe(root.getKey("/StructTreeRoot").getKey("/K"), description.figures, next);
}

}  // namespace

void make_archive(const std::string& tagged, const std::filesystem::path& output,
                  const std::optional<Attachment>& attachment,
                  const std::optional<PdfDescription>& description) {
  QPDF pdf;
  pdf.setSuppressWarnings(true);
  pdf.processMemoryFile("pages", tagged.data(), tagged.size());
  add_output_intent(pdf);
  std::string more = kPdfUa;
  if (description) {
    add_description(pdf, *description);
    const std::string& date = description->created_utc;
    more = date.empty() ? "" : fmt::format("<xmp:CreateDate>{}</xmp:CreateDate>", escaped(date));
  }
  add_metadata(pdf, more);
  if (attachment) add_attachment(pdf, *attachment);
  // The order of tabulators follows the tags (ISO 14289-1, 7.18.3).
  for (QPDFPageObjectHelper& page : QPDFPageDocumentHelper(pdf).getAllPages())
    page.getObjectHandle().replaceKey("/Tabs", QPDFObjectHandle::newName("/S"));
  QPDFWriter writer(pdf, output.c_str());
  writer.setMinimumPDFVersion("1.7");
  writer.setObjectStreamMode(qpdf_o_generate);
  writer.setDeterministicID(true);
  writer.write();
}

std::string attached_data(const std::filesystem::path& path) {
  QPDF pdf;
  pdf.setSuppressWarnings(true);
  pdf.processFile(path.c_str());
  for (const auto& [name, file] : QPDFEmbeddedFileDocumentHelper(pdf).getEmbeddedFiles()) {
    QPDFObjectHandle relation = file->getObjectHandle().getKey("/AFRelationship");
    if (!relation.isName() || relation.getName() != "/Data") continue;
    const auto bytes = file->getEmbeddedFileStream().getStreamData(qpdf_dl_all);
    return {reinterpret_cast<const char*>(bytes->getBuffer()), bytes->getSize()};
  }
  return {};
}

}  // namespace abcal
