# The headers of toml++ 3.3; app/formats/toml_library.cc compiles what they declare. The target of its package would link the
# shared library as well.
find_package(tomlplusplus 3.3 REQUIRED)
get_target_property(toml_include tomlplusplus::tomlplusplus INTERFACE_INCLUDE_DIRECTORIES)
add_library(abcal_toml_headers INTERFACE)
target_include_directories(abcal_toml_headers SYSTEM INTERFACE ${toml_include})
target_compile_definitions(abcal_toml_headers INTERFACE TOML_HEADER_ONLY=0)
add_library(abcal::toml_headers ALIAS abcal_toml_headers)
