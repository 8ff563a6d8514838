#include "app/laboratory/certificate/dcc_xml.h"

#include "app/laboratory/certificate/dcc_administrative.h"
#include "app/laboratory/certificate/dcc_results.h"

namespace abcal {

XmlElement dcc_root(const XmlDocument& document) {
  xmlNode* node = xmlNewDocNode(document.get(), nullptr, as_xml("digitalCalibrationCertificate"), nullptr);
  xmlDocSetRootElement(document.get(), node);
  xmlSetNs(node, xmlNewNs(node, as_xml("https://ptb.de/dcc"), as_xml("dcc")));
  xmlNewNs(node, as_xml("https://ptb.de/si"), as_xml("si"));
  xmlNs* instance = xmlNewNs(node, as_xml("http://www.w3.org/2001/XMLSchema-instance"), as_xml("xsi"));
  xmlNewNsProp(node, instance, as_xml("schemaLocation"),
               as_xml("https://ptb.de/dcc https://ptb.de/dcc/v3.3.0/dcc.xsd"));
  xmlNewProp(node, as_xml("schemaVersion"), as_xml(kDccVersion));
  return XmlElement(node);
}

XmlDocument dcc_document(const Certificate& certificate) {
  XmlDocument document(xmlNewDoc(as_xml("1.0")));
  XmlElement root = dcc_root(document);
  add_administrative_data(root, certificate);
  add_measurement_results(root, certificate);
  return document;
}

}  // namespace abcal
