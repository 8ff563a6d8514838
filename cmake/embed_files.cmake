# Writes a C++ file with the bytes of others: cmake -DOUTPUT=x.cc "-DFILES=/index.html=path;..." -P embed_files.cmake
# Each becomes an abcal::console::Asset, served under the path before the "="; or a TYPE of NAMESPACE and HEADER, in FUNCTION.
if(NOT DEFINED HEADER)
  set(HEADER app/console/asset.h)
  set(NAMESPACE abcal::console)
  set(TYPE Asset)
  set(FUNCTION assets)
endif()
string(REPLACE "," ";" FILES "${FILES}")
set(bytes "")
set(table "")
set(count 0)
foreach(entry IN LISTS FILES)
  string(REGEX MATCH "^([^=]+)=(.+)$" matched "${entry}")
  set(served "${CMAKE_MATCH_1}")
  set(file "${CMAKE_MATCH_2}")
  file(READ "${file}" hex HEX)
  string(REGEX REPLACE "(..)" "0x\\1," hex "${hex}")
  string(APPEND bytes "constexpr unsigned char kFile${count}[] = {${hex}};\n")
  string(APPEND table "      {\"${served}\", {reinterpret_cast<const char*>(kFile${count}), sizeof kFile${count}}},\n")
  math(EXPR count "${count} + 1")
endforeach()
file(WRITE "${OUTPUT}"
"// Made by cmake/embed_files.cmake.
#include \"${HEADER}\"

namespace ${NAMESPACE} {
namespace {
${bytes}}  // namespace

const std::vector<${TYPE}>& ${FUNCTION}() {
  static const std::vector<${TYPE}> all{
${table}  };
  return all;
}

}  // namespace ${NAMESPACE}
")
