# Include roots ("doors"): a target sees no file of the project but those that its layer may include (cmake/layers.cmake). Each
# layer has a folder in the build tree with symbolic links to exactly these. #include "protocol/plan/limits.h" is looked up there,
# so that an include that points the wrong way does not compile, in unity builds neither.
set(SOURCE_DIR ${PROJECT_SOURCE_DIR})
set(ABCAL_DOORS ${PROJECT_BINARY_DIR}/doors)

# Links `path` (a folder or header of the project) below the door, unless a folder above it is linked already.
function(abcal_link door path)
  string(REGEX REPLACE "/$" "" path ${path})
  set(above ${path})
  while(above MATCHES "/")
    get_filename_component(above ${above} DIRECTORY)
    if(IS_SYMLINK ${door}/${above})
      return()
    endif()
  endwhile()
  if(IS_SYMLINK ${door}/${path} OR NOT EXISTS ${PROJECT_SOURCE_DIR}/${path})
    return()
  endif()
  get_filename_component(folder ${path} DIRECTORY)
  file(MAKE_DIRECTORY ${door}/${folder})
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/${path} ${door}/${path} SYMBOLIC)
endfunction()

# Makes the door of a layer; called by cmake/layers.cmake.
function(layer folder)
  cmake_parse_arguments(ARG "TOP" "" "MAY;FOREIGN" ${ARGN})
  set(paths ${folder} drivers/text ${ARG_MAY})
  list(SORT paths)  # A folder comes before what stands in it.
  string(REPLACE "/" "_" name ${folder})
  foreach(path IN LISTS paths)
    abcal_link(${ABCAL_DOORS}/${name} ${path})
  endforeach()
  set_property(GLOBAL APPEND PROPERTY ABCAL_LAYERS ${folder})
endfunction()

file(REMOVE_RECURSE ${ABCAL_DOORS})
include(layers)
# Tests see everything, and each other.
foreach(path app drivers protocol sim tests)
  abcal_link(${ABCAL_DOORS}/tests ${path})
endforeach()

# The door of a file: that of the longest listed folder above it.
function(abcal_door_of source result)
  cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY ${CMAKE_CURRENT_SOURCE_DIR})
  cmake_path(RELATIVE_PATH source BASE_DIRECTORY ${PROJECT_SOURCE_DIR})
  get_property(layers GLOBAL PROPERTY ABCAL_LAYERS)
  set(best "")
  foreach(layer IN LISTS layers ITEMS tests)
    string(FIND "${source}" "${layer}/" at)
    string(LENGTH "${layer}" length)
    string(LENGTH "${best}" longest)
    if(at EQUAL 0 AND length GREATER longest)
      set(best ${layer})
    endif()
  endforeach()
  if(best STREQUAL "")
    message(FATAL_ERROR "${source} stands in no layer: add its folder to cmake/layers.cmake")
  endif()
  string(REPLACE "/" "_" name ${best})
  set(${result} ${ABCAL_DOORS}/${name} PARENT_SCOPE)
endfunction()
