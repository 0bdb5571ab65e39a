# find_package(shmgen) gives shmgen_generate(): bindings written at build time, and a target to link headers from.
#
#   shmgen_generate(<target>
#     [CONFIG <shmgen.toml>]       default: the one beside CMakeLists.txt
#     [INCLUDE <folder>...]        where message packages are looked for before all others
#     [OUTPUT <folder>]            default: <build folder>/<target>
#     [TARGETS <target>...]        what to write, c and cpp and so on; default: the `targets` of shmgen.toml
#     [INSTALL])                   headers to include/, Python and Structured Text to share/<project>/shmgen
#
# <target> is an INTERFACE library: linked, it gives the headers of OUTPUT/c and OUTPUT/cpp and what they need of the
# system. Python is in OUTPUT/python. All is written anew when shmgen.toml or a definition below the INCLUDE folders and
# the folder of shmgen.toml has changed.
cmake_minimum_required(VERSION 3.16)

find_program(SHMGEN_EXECUTABLE shmgen HINTS "${CMAKE_CURRENT_LIST_DIR}/../../../bin")
if(NOT SHMGEN_EXECUTABLE)
  set(shmgen_FOUND FALSE)
  set(shmgen_NOT_FOUND_MESSAGE "no program shmgen in PATH: install it with pip, and start from the environment that has it")
  return()
endif()

function(shmgen_generate target)
  cmake_parse_arguments(PARSE_ARGV 1 ARG "INSTALL" "CONFIG;OUTPUT" "INCLUDE;TARGETS")
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "shmgen_generate(${target}): what is ${ARG_UNPARSED_ARGUMENTS}?")
  endif()
  if(NOT ARG_CONFIG)
    set(ARG_CONFIG shmgen.toml)
  endif()
  if(NOT ARG_OUTPUT)
    set(ARG_OUTPUT "${CMAKE_CURRENT_BINARY_DIR}/${target}")
  endif()
  get_filename_component(config "${ARG_CONFIG}" ABSOLUTE)
  get_filename_component(home "${config}" DIRECTORY)
  set(options "")
  set(definitions "")
  foreach(folder IN LISTS ARG_INCLUDE ITEMS "${home}")
    get_filename_component(folder "${folder}" ABSOLUTE)
    file(GLOB_RECURSE found CONFIGURE_DEPENDS "${folder}/*.msg" "${folder}/*.srv" "${folder}/*.action")
    list(APPEND definitions ${found})
    if(NOT folder STREQUAL home)
      list(APPEND options -I "${folder}")
    endif()
  endforeach()
  foreach(wanted IN LISTS ARG_TARGETS)
    list(APPEND options -t "${wanted}")
  endforeach()
  set(stamp "${CMAKE_CURRENT_BINARY_DIR}/${target}.stamp")
  add_custom_command(
    OUTPUT "${stamp}"
    COMMAND "${SHMGEN_EXECUTABLE}" generate --quiet --config "${config}" --output "${ARG_OUTPUT}" ${options}
    COMMAND "${CMAKE_COMMAND}" -E touch "${stamp}"
    DEPENDS "${config}" ${definitions}
    COMMENT "shmgen generate ${target}"
    VERBATIM)
  add_custom_target(${target}_files ALL DEPENDS "${stamp}")
  add_library(${target} INTERFACE)
  add_dependencies(${target} ${target}_files)
  target_include_directories(${target} SYSTEM INTERFACE "${ARG_OUTPUT}/c" "${ARG_OUTPUT}/cpp")
  if(UNIX)
    target_link_libraries(${target} INTERFACE pthread rt)  # in the C library itself since glibc 2.34
  endif()
  if(ARG_INSTALL)
    install(DIRECTORY "${ARG_OUTPUT}/c/" "${ARG_OUTPUT}/cpp/" DESTINATION include OPTIONAL)
    install(DIRECTORY "${ARG_OUTPUT}/python" "${ARG_OUTPUT}/st" "${ARG_OUTPUT}/plcopen"
      DESTINATION "share/${PROJECT_NAME}/shmgen" OPTIONAL PATTERN __pycache__ EXCLUDE)
  endif()
endfunction()
