#!/usr/bin/python3
"""What sixteen_findings.sh looks for in files: look_at.py WHAT FILE... says what it found; ends with 1 if it is not good."""
import json
import math
import re
import sys
import xml.etree.ElementTree as tree

NAMESPACES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def budget(report):
    """The budget of each output combines to its stated standard uncertainty."""
    data = json.load(open(report))
    result = data["results"][0]
    stated = {f"s_{a}{x}": result["sensitivity_matrix"][j][k] for j, a in enumerate("uvw") for k, x in enumerate("xyz")}
    for group, symbol, names in (("offset", "O_", "u v w"), ("intrinsic_sensitivity", "s_", "u v w"),
                                 ("intrinsic_angle", "phi_", "uv vw wu")):
        stated.update({symbol + name: value for name, value in zip(names.split(), result[group])})
    worst = 0.0
    for name, value in stated.items():
        squares = (line["contribution"][name] for line in data["budget"]["lines"])
        combined = math.sqrt(sum(c * c for c in squares if c is not None))
        worst = max(worst, abs(combined / value["standard_uncertainty"] - 1.0))
    return worst < 1e-9, f"{len(stated)} outputs: budget and stated u differ by at most {worst:.1e} of u"


def numbers_in(text):
    text = text.replace("−", "-")
    text = re.sub(r"\s*×\s*10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)",
                  lambda m: "e{:+03d}".format(int(m.group(1).translate(SUPERSCRIPTS))), text)
    return set(re.findall(r"-?[0-9]+(?:\.[0-9]+)?(?:e[-+][0-9]+)?", text))


def numbers(xml, pages):
    """Every number of the pages is in the XML."""
    words = " ".join(tree.parse(xml).getroot().itertext())
    shown = numbers_in(re.sub(r"page [0-9]+ of [0-9]+", "", open(pages).read()))
    hashes = " ".join(re.findall("[0-9a-f]{64}", words))  # Broken over lines on the page.
    known = numbers_in(words)
    unknown = sorted(n for n in shown if n not in known and n not in hashes)
    return not unknown, f"{len(shown)} different numbers on the pages, not in the XML: {', '.join(unknown) or 'none'}"


def results(xml):
    """One refType a result, and each value has the place of the last digit of its U."""
    root = tree.parse(xml).getroot()
    types = [r.get("refType") for r in root.findall(".//dcc:result", NAMESPACES)]
    lists = root.findall(".//si:realListXMLList", NAMESPACES)
    measured = [l for l in lists if l.find("si:measurementUncertaintyUnivariateXMLList", NAMESPACES) is not None]
    bare = [l for l in measured if l.find("si:significantDigitXMLList", NAMESPACES) is None]
    long = [word for l in measured for word in l.find("si:valueXMLList", NAMESPACES).text.split()
            if len(re.sub(r"e.*|[-.]", "", word).lstrip("0")) > 10]
    good = len(set(types)) == len(types) and measured and not bare and not long
    return good, (f"{len(types)} results of {len(set(types))} refTypes; of {len(measured)} lists with U {len(bare)} have no "
                  f"significantDigit; values of more than 10 digits: {len(long)}")


def pages(boxes, text):
    """No page but the last is more than a quarter empty; no number is written with E or a hyphen for its minus."""
    top, bottom, filled = 20 / 297, 280 / 297, []
    for page in re.split("<page ", open(boxes).read())[1:]:
        edges = (float(y) / 841.89 for y in re.findall(r'yMax="([0-9.]+)"', page))
        lowest = max(y for y in edges if y < bottom)
        filled.append((lowest - top) / (bottom - top))
    hyphens = re.findall(r"(?:^|\s)-[0-9]+\.[0-9]+(?:\s|$)|[0-9]e[-+][0-9]", open(text).read(), re.M)
    good = min(filled[:-1]) >= 0.75 and not hyphens
    return good, f"{len(filled)} pages, filled to {', '.join(f'{f:.0%}' for f in filled)}; plain minus or E: {len(hyphens)}"


def hdf5(path):
    """Indices are integers, the unit of g is gravity, the definition is named."""
    import h5py
    with h5py.File(path) as file:
        entry = file["entry"]
        data = entry["averaged"]
        indices, unit = data.attrs["alpha_indices"], data["response"].attrs["units"]
        definition = entry["definition"][()].decode()
    good = indices.dtype.kind == "i" and unit == "gravity" and definition == "NXabc_calibration"
    return good, f"alpha_indices {indices} ({indices.dtype}), response in \"{unit}\", definition {definition}"


if __name__ == "__main__":
    good, words = {f.__name__: f for f in (budget, numbers, results, pages, hdf5)}[sys.argv[1]](*sys.argv[2:])
    print(words)
    sys.exit(0 if good else 1)
